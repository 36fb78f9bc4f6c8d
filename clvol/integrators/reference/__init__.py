"""The method "reference": the exact integral along each ray; slow, and the ground truth of all other integrators."""
