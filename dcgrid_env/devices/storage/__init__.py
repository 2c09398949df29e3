"""Storage of electric energy: batteries, UPS and capacitors, at a separate bus or at a site's."""
