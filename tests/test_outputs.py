import os
from pathlib import Path

import pytest

from touchnet import outputs


def test_output_appears_whole(tmp_path):
    final = tmp_path / "mesh.ply"
    with outputs.atomic_output(final) as path:
        assert path.parent == tmp_path
        assert path.suffix == ".ply"
        path.write_text("whole")
        assert not final.exists()
    assert final.read_text() == "whole"
    assert [p.name for p in tmp_path.iterdir()] == ["mesh.ply"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_output_after_an_error_is_as_before(error, tmp_path):
    final = tmp_path / "mesh.ply"
    final.write_text("old")
    with pytest.raises(error), outputs.atomic_output(final, force=True) as path:
        path.write_text("ha")
        raise error
    assert final.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["mesh.ply"]


def test_output_is_not_overwritten_without_force(tmp_path):
    final = tmp_path / "mesh.ply"
    final.write_text("old")
    with pytest.raises(FileExistsError, match=r"mesh\.ply exists; --force overwrites it"):
        outputs.check_output(final)
    with outputs.atomic_output(final, force=True) as path:
        path.write_text("new")
    assert final.read_text() == "new"


def test_output_that_appeared_meanwhile_is_kept(tmp_path):
    final = tmp_path / "mesh.ply"
    with pytest.raises(FileExistsError), outputs.atomic_output(final) as path:
        path.write_text("ours")
        final.write_text("theirs")
    assert final.read_text() == "theirs"


def test_output_into_nowhere(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"folder .*absent does not exist"):
        outputs.check_output(tmp_path / "absent" / "mesh.ply")
    with pytest.raises(IsADirectoryError, match="is a folder"):
        outputs.check_output(tmp_path)


@pytest.mark.skipif(os.name == "nt", reason="links need rights on Windows")
def test_output_follows_a_link_and_spares_devices(tmp_path):
    real = tmp_path / "real.txt"
    real.write_text("old")
    link = tmp_path / "link.txt"
    link.symlink_to(real)
    with outputs.atomic_output(link, force=True) as path:
        path.write_text("new")
    assert link.is_symlink()
    assert real.read_text() == "new"
    with outputs.atomic_output(os.devnull) as path:
        assert path == Path(os.devnull)


@pytest.mark.skipif(os.name == "nt", reason="POSIX permissions")
def test_a_file_that_is_not_whole_is_private(tmp_path):
    old = os.umask(0o022)
    try:
        with outputs.atomic_output(tmp_path / "mesh.ply") as path:
            assert path.stat().st_mode & 0o777 == 0o600
        assert (tmp_path / "mesh.ply").stat().st_mode & 0o777 == 0o644, "as any new file"
        (tmp_path / "mesh.ply").chmod(0o640)
        with outputs.atomic_output(tmp_path / "mesh.ply", force=True) as path:
            assert path.stat().st_mode & 0o777 == 0o600
        assert (tmp_path / "mesh.ply").stat().st_mode & 0o777 == 0o640, "as the file that it replaced"
    finally:
        os.umask(old)
