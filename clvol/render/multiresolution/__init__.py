"""Rendering of volumes as blocks at several resolutions (P2): what is resident, and rays through it."""
