"""Where something touches the gel, and what each contact measures."""

from gelform.contact.contacts import Contact, contacts_from_mask
from gelform.contact.mask import PreparedContact, contact_from_depth, noise_by_place

__all__ = ["Contact", "PreparedContact", "contact_from_depth", "contacts_from_mask", "noise_by_place"]
