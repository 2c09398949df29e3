"""Storage of electric energy: batteries, UPS and capacitors, at a bus of their own or at a site's."""
