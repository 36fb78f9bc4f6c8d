"""Whether a worker has the program and the files of the client."""

from __future__ import annotations

import numpy as np

import clvol
from clvol.cluster import facts
from clvol.cluster.facts import Digests, different_program, program_facts


def test_the_same_program_fits_and_another_is_named():
    assert different_program(program_facts()) is None
    told = different_program({**program_facts(), "version": "9.9"})
    assert told == f"it has clvol {clvol.__version__}, and the client 9.9"
    assert "OpenCL kernels" in different_program({**program_facts(), "kernels": "0"})


def test_kernels_that_differ_have_another_digest(tmp_path, monkeypatch):
    (tmp_path / "a.cl").write_text("x")
    monkeypatch.setattr(facts, "kernel_folder", lambda: tmp_path)
    facts.kernels_digest.cache_clear()
    try:
        first = facts.kernels_digest()
        (tmp_path / "a.cl").write_text("y")
        facts.kernels_digest.cache_clear()
        assert facts.kernels_digest() != first
    finally:
        facts.kernels_digest.cache_clear()


def test_a_file_that_differs_or_is_missing_is_named(tmp_path):
    np.save(tmp_path / "v.npy", np.zeros(8))
    expected = Digests().of([tmp_path / "v.npy"])
    assert Digests().difference(expected) is None
    np.save(tmp_path / "v.npy", np.ones(8))
    assert "v.npy has the digest" in Digests().difference(expected)
    (tmp_path / "v.npy").unlink()
    assert Digests().difference(expected) == f"it cannot read {tmp_path / 'v.npy'}"


def test_what_the_client_cannot_read_is_no_difference(tmp_path):
    """Its task says why."""
    assert Digests().difference(Digests().of([tmp_path / "none.npy"])) is None


def test_files_that_a_header_names_and_patterns_count(tmp_path):
    (tmp_path / "v.raw").write_bytes(b"x" * 8)
    header = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 2 2 2\nencoding: raw\ndata file: v.raw\n"
    (tmp_path / "v.nhdr").write_text(header)
    assert str(tmp_path / "v.raw") in Digests().of([tmp_path / "v.nhdr"])
    for k in range(3):
        (tmp_path / f"t_{k}.npy").write_bytes(bytes([k]))
    assert [name[-7:] for name in Digests().of([tmp_path / "t_*.npy"])] == ["t_0.npy", "t_1.npy", "t_2.npy"]


def test_pictures_and_claims_that_appear_in_a_folder_of_slices_do_not_count(tmp_path):
    (tmp_path / "one.dcm").write_bytes(bytes(128) + b"DICM" + bytes(9))
    expected = Digests().of([tmp_path])
    (tmp_path / "out.png").write_bytes(b"\x89PNG and more")
    (tmp_path / ".out.png.claim").write_bytes(b"?")
    assert Digests().difference(expected) is None
    (tmp_path / "two.dcm").write_bytes(bytes(128) + b"DICM" + bytes(9))
    assert "has the digest" in Digests().difference(expected)
