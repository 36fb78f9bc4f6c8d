"""Accuracy: errors of pictures, the ground truth, and the search for settings by error or time."""
