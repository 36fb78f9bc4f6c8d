"""How work is divided into frames, tiles and launches: arithmetic that needs no device."""
