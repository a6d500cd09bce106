"""Second derivatives and the bioreactor."""
