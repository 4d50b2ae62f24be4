"""Contacts: where something touches the gel, by the pressure and its own uncertainty, and the measures of each."""

from gelform.depth.contact.pressure import PreparedContact, SlopeDeviations, contact_from_depth
from gelform.depth.contact.regions import Contact, contacts_from_mask, unknown_contact
from gelform.depth.contact.surround import Surround

__all__ = [
    "Contact",
    "PreparedContact",
    "SlopeDeviations",
    "Surround",
    "contact_from_depth",
    "contacts_from_mask",
    "unknown_contact",
]
