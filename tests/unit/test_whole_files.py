"""Files are written whole, to where their names lead, and only over plain files."""

import os
import platform
import stat
import subprocess
import sys

import pytest

from cloudtomo_cl.commands.cli import main
from cloudtomo_cl.errors import DataError
from cloudtomo_cl.files import whole
from cloudtomo_cl.files.whole import written_whole

needs_posix = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="links, modes and pipes of POSIX")


def write(path, text="new"):
    with written_whole(path) as partial:
        partial.write_text(text)


@needs_posix
def test_a_link_stays_and_leads_to_the_new_file(tmp_path):
    (tmp_path / "there").mkdir()
    for name in ("there/file", "there/absent"):
        link = tmp_path / f"link to {name[6:]}"
        link.symlink_to(tmp_path / name)
    (tmp_path / "there" / "file").write_text("old")
    for link in tmp_path.glob("link*"):
        write(link)
        assert link.is_symlink() and link.read_text() == "new"
    assert sorted(os.listdir(tmp_path / "there")) == ["absent", "file"]


@needs_posix
@pytest.mark.parametrize("mode", [0o600, 0o640, 0o664])
def test_a_file_keeps_its_mode(tmp_path, mode):
    path = tmp_path / "file"
    path.write_text("old")
    path.chmod(mode)
    write(path)
    assert stat.S_IMODE(path.stat().st_mode) == mode and path.read_text() == "new"


@needs_posix
def test_a_new_file_has_the_mode_of_any(tmp_path):
    (tmp_path / "any").write_text("")
    write(tmp_path / "new")
    assert (tmp_path / "new").stat().st_mode == (tmp_path / "any").stat().st_mode


@needs_posix
def test_a_protected_file_is_not_replaced(tmp_path):
    path = tmp_path / "file"
    path.write_text("old")
    path.chmod(0o444)
    with pytest.raises(DataError, match="is protected against writing"):
        write(path)
    assert path.read_text() == "old"


@needs_posix
@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "link to a pipe"])
def test_what_is_no_plain_file_is_refused(tmp_path, kind):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    (tmp_path / "link").symlink_to(pipe)
    path = {"pipe": pipe, "device": "/dev/null", "folder": tmp_path, "link to a pipe": tmp_path / "link"}[kind]
    before = os.lstat(path)
    with pytest.raises(DataError, match="is no plain file|is a folder"):
        write(path)
    assert os.lstat(path).st_ino == before.st_ino and os.lstat(path).st_mode == before.st_mode


def test_temporary_names_cannot_be_guessed_nor_taken(tmp_path):
    names = set()
    for _ in range(3):
        with written_whole(tmp_path / "file") as partial:
            names.add(partial.name)
            assert partial.parent == tmp_path and partial.exists()
            with pytest.raises(FileExistsError):
                os.close(os.open(partial, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
    assert len(names) == 3


def test_what_a_dead_process_left_is_removed_and_nothing_else(tmp_path, monkeypatch):
    child = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
    gone, alive, token = int(child.stdout), os.getppid(), "0" * 16
    here = whole._machine()
    monkeypatch.setattr(platform, "node", lambda: "another")
    elsewhere = whole._machine()
    monkeypatch.undo()
    stale = tmp_path / f".file.{here}-{gone}-{token}.partial"
    others = [
        tmp_path / f".file.{here}-{alive}-{token}.partial",
        tmp_path / f".file.{elsewhere}-{gone}-{token}.partial",
        tmp_path / f".other.{here}-{gone}-{token}.partial",
        tmp_path / ".file.partial",
    ]
    for path in (stale, *others):
        path.touch()
    write(tmp_path / "file")
    assert not stale.exists() and all(path.exists() for path in others)


@pytest.mark.parametrize("picture", ["png", "pdf", "svg"])
def test_pictures_are_written_whole(tmp_path, monkeypatch, picture):
    monkeypatch.chdir(tmp_path)
    generate = "cloud --generate cumulus --shape 8 8 8 --spacing 0.1 0.1 0.1 --quiet --output cloud.nc".split()
    path = tmp_path / f"cloud.{picture}"
    path.write_text("old")
    from matplotlib.figure import Figure

    def fail(self, partial, **options):
        assert options["format"] == picture
        partial.write_text("half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Figure, "savefig", fail)
    assert main([*generate, "--png", path.name, "--overwrite"]) == 2
    assert path.read_text() == "old" and sorted(os.listdir(tmp_path)) == ["cloud.nc", f"cloud.{picture}"]


def test_settings_that_somebody_edited_outlive_a_full_disk(tmp_path, monkeypatch, capsys):
    path = tmp_path / "scene.toml"
    path.write_text("edited")

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    assert main(["init", "render", "--output", str(path), "--overwrite"]) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert path.read_text() == "edited" and os.listdir(tmp_path) == ["scene.toml"]
