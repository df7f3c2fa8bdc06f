"""Points in: readers, inspection, normalisation, neighbours."""
