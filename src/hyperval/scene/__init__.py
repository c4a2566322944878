"""Surface classes, mixtures and targets, and their radiance statistics (3.7-3.12)."""
