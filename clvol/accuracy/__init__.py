"""Accuracy: how far one picture is from another, and from the exact integral."""
