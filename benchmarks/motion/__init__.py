"""Parts of motion.py."""
