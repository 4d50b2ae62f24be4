"""Force in newtons: from the volume of a contact, and from the motion of the gel's dots; or the reason for none."""
