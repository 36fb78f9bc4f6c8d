"""What is shipped as data: whole, and with its source and licence named."""

from __future__ import annotations

from helpers.paths import DATA


def test_every_volume_names_its_source_and_licence():
    text = (DATA / "README.md").read_text(encoding="utf-8")
    for path in DATA.iterdir():
        if path.name != "README.md":
            line = next(line for line in text.splitlines() if f"`{path.name}`" in line)
            assert "MIT" in line or "BSD" in line


def test_the_demo_scene_is_valid_and_shows_the_demo_volume():
    import clvol

    resolved = clvol.load_scene(DATA / "demo.toml").resolve()
    assert resolved.volume.shape == (84, 128, 128)
    assert (resolved.image.width, resolved.image.height) == (512, 512)
