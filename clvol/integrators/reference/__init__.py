"""The exact integral along each ray: slow, and the ground truth of all other integrators."""
