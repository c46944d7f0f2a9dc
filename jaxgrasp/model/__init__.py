"""The types every other layer speaks, and the conventions they carry."""
