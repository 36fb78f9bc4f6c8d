"""The method "pyramid": adaptive sampling along rays and across them (Kraus et al. 2007)."""
