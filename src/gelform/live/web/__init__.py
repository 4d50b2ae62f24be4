"""The server: requests, websockets, and access control."""
