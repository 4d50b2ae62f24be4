"""Where something touches the gel, and what each contact measures."""

from gelform.contact.contacts import Contact, contacts_from_mask
from gelform.contact.mask import contact_from_depth, contact_unchecked

__all__ = ["Contact", "contact_from_depth", "contact_unchecked", "contacts_from_mask"]
