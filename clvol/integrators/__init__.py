"""Integrators: the ways of rendering a scene, one folder each."""
