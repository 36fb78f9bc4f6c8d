"""The method "pyramid": adaptive sampling along rays and across them (P1, Kraus et al. 2007)."""
