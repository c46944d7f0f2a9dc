"""Other ways to the constrained optimum, one file each, behind one interface; all but our own are optional packages."""
