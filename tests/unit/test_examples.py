"""The commands and settings that documentation and help show are such as the program takes."""

import re
import shlex
from pathlib import Path

import pytest

from cloudtomo_cl.commands.cli import COMMANDS, parser
from cloudtomo_cl.settings.tables import read_reconstruct_settings, read_render_settings

TOP = Path(__file__).parents[2]
PAGES = [TOP / "README.md", *sorted((TOP / "docs").rglob("*.md"))]


def blocks(page, language=""):
    """What stands between ```language and ```."""
    found = re.findall(r"^```(\w*)\n(.*?)^```", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    return [text for name, text in found if name == language]


def shown_in_pages():
    lines = [line.strip() for page in PAGES for block in blocks(page) for line in block.splitlines()]
    return [line.removeprefix("srun ") for line in lines if re.match(r"(srun )?cloudtomo ", line)]


def shown_in_help(command):
    texts = [parser().format_help()] if command is None else []
    if command is not None:
        (subparsers,) = (action for action in parser()._actions if action.dest == "command")
        texts = [subparsers.choices[command].epilog]
    return [line.strip() for text in texts for line in text.splitlines() if line.startswith("  cloudtomo ")]


@pytest.fixture
def folder(tmp_path):
    """With files of the names that settings show, which must exist."""
    for name in ("cloud.nc", "images.nc"):
        (tmp_path / name).touch()
    return tmp_path


def is_taken(line):
    words = shlex.split(line.partition(" > ")[0], comments=True)[1:]
    try:
        parser().parse_args(words)
    except SystemExit as ended:  # of what prints and ends
        assert not ended.code


@pytest.mark.parametrize("line", shown_in_pages())
def test_a_command_of_the_documentation_is_understood(line):
    is_taken(line)


def test_the_documentation_shows_commands():
    assert len(shown_in_pages()) > 8


@pytest.mark.parametrize("command", [None, *COMMANDS])
def test_the_commands_of_the_help_are_understood(command):
    lines = shown_in_help(command)
    assert lines
    for line in lines:
        is_taken(line)


def test_the_settings_of_the_first_recovery_are_taken(folder):
    scene, run = blocks(TOP / "docs" / "tutorial" / "first-recovery.md", "toml")
    for name, text in (("scene.toml", scene), ("run.toml", run)):
        (folder / name).write_text(text)
    assert len(read_render_settings(folder / "scene.toml").view) == 2
    assert read_reconstruct_settings(folder / "run.toml").measurements.file == folder / "images.nc"


@pytest.mark.parametrize("command", ["render", "reconstruct"])
def test_the_settings_of_the_help_are_taken(command, folder):
    (subparsers,) = (action for action in parser()._actions if action.dest == "command")
    text = subparsers.choices[command].epilog
    name = {"render": "scene.toml", "reconstruct": "run.toml"}[command]
    lines = text.split(f"{name}:\n")[1].splitlines()
    (folder / name).write_text("\n".join(line for line in lines if line.startswith("  ")))
    read = {"render": read_render_settings, "reconstruct": read_reconstruct_settings}[command]
    assert read(folder / name)
