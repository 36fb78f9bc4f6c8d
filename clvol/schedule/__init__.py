"""How work is cut up: pure arithmetic, testable without a device."""
