"""Readers and writers of plain files, which are written whole or not at all."""
