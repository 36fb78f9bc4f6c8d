"""The ways of rendering a scene, one folder each."""
