"""The house as CONTRIBUTING.md tells it: which room may know which, sizes, what ships."""

import ast
import configparser
import re
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

import pytest

TOP = Path(__file__).parents[2]
# Lower rooms first: nothing imports from a higher one, also where it is for types alone.
ROOMS = (
    "errors", "renamed", "arguments", "messages", "memory", "versions", "blas", "parallel", "scene", "reference",
    "opencl", "files", "transport", "clouds", "inversion", "validation", "settings", "report", "commands",
)  # fmt: skip
# Packages that only some files know.
KNOWN_BY = {
    "pyopencl": ("opencl/*",),
    "matplotlib": ("report/*",),
    "rich": ("commands/*",),
    "xarray": ("files/*", "clouds/*"),
    "netCDF4": ("files/*", "commands/run_folder.py"),
    "psutil": ("memory.py", "files/whole.py"),
    "miepython": ("clouds/mie.py",),
    "mpi4py": ("parallel/mpi.py",),
}
LINES_OF_FILE, LINES_OF_FUNCTION, CONDITIONALS_OF_WALK = 500, 60, 11
# What is longer, how long it may be, and why.
LONGER_FILES = {
    "cloudtomo_cl/reference/paths.py": 545,  # the twin of kernels/walk, in one piece to read it beside them
}
LONGER_FUNCTIONS = {
    "cloudtomo_cl/clouds/mie.py:droplet_table": 61,  # a signature of nine lines
    "scripts/benchmarks/peers.py:gradient": 61,  # another program's script, as it is run
}


def name(path):
    return path.relative_to(TOP).as_posix()


def sources(*folders, kinds):
    return [path for folder in folders for kind in kinds for path in sorted((TOP / folder).rglob(f"*.{kind}"))]


PACKAGE = sources("cloudtomo_cl", kinds=["py", "pyi"])
KERNELS = sources("kernels", kinds=["h", "cl"])
PYTHON = PACKAGE + sources("scripts", "tests", kinds=["py"])
# What gathers from all rooms.
FACE = ("__init__", "__main__")


@cache
def tree(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def imports(path):
    """The full names of what a file imports, wherever in it."""
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = ["cloudtomo_cl", *path.relative_to(TOP / "cloudtomo_cl").parent.parts]
            start = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*start, *filter(None, [node.module])])
            yield from (f"{module}.{alias.name}" for alias in node.names)


def room(module):
    """Its place among the rooms; -1 for the package itself."""
    parts = module.split(".")
    return ROOMS.index(parts[1]) if len(parts) > 1 and parts[1] in ROOMS else -1


def module(path):
    return ".".join(path.relative_to(TOP).with_suffix("").parts)


def functions(path):
    """Names and lengths of a Python file's functions, without their docstrings."""
    for node in ast.walk(tree(path)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            text = node.body[0] if ast.get_docstring(node) is not None else None
            said = text.end_lineno - text.lineno + 1 if text else 0
            yield node.name, node.end_lineno - node.lineno + 1 - said


def kernel_functions(path):
    """Names and lengths of an OpenCL C file's functions, whose braces stand at the start of lines."""
    text = path.read_text(encoding="utf-8")
    for found in re.finditer(r"(\w+)\([^;{}]*\)\s*^\{$.*?^\}$", text, flags=re.DOTALL | re.MULTILINE):
        yield found[1], found[0].count("\n") + 1


def test_every_file_is_in_a_room():
    lost = [name(path) for path in PACKAGE if room(module(path)) < 0 and path.stem not in FACE]
    assert not lost, f"add their rooms to ROOMS, in the order of who imports whom: {lost}"


def test_a_lower_room_does_not_import_from_a_higher_one():
    upward = [
        f"{name(path)} imports {other}"
        for path in PACKAGE
        for other in imports(path)
        if path.stem not in FACE and other.startswith("cloudtomo_cl") and room(other) > room(module(path))
    ]
    assert not upward, "move what is needed down, or hand it in"


@pytest.mark.parametrize("package", KNOWN_BY)
def test_a_package_is_known_only_where_it_is_dealt_with(package):
    knowing = [path.relative_to(TOP / "cloudtomo_cl").as_posix() for path in PACKAGE
               if any(other.split(".")[0] == package for other in imports(path))]  # fmt: skip
    assert [path for path in knowing if not any(fnmatch(path, allowed) for allowed in KNOWN_BY[package])] == []
    assert knowing, f"nothing imports {package} any more: take it out of KNOWN_BY and setup.cfg"


def test_no_module_imports_itself_by_others():
    """Imports for types alone, and those of functions when they are called, are counted."""
    graph = {module(path): set() for path in PACKAGE if path.suffix == ".py"}
    for path in PACKAGE:
        if path.suffix == ".py" and path.stem not in FACE:
            parts = {part for other in imports(path) for part in (other, other.rpartition(".")[0])}
            graph[module(path)] |= parts & graph.keys()
    done = set()
    while ready := {one for one, needed in graph.items() if one not in done and needed <= done}:
        done |= ready
    assert not set(graph) - done, "these import each other, or what does"


def test_files_are_short():
    lengths = {name(path): len(path.read_text(encoding="utf-8").splitlines()) for path in PYTHON + KERNELS}
    assert not {path: n for path, n in lengths.items() if n > LONGER_FILES.get(path, LINES_OF_FILE)}


def test_functions_are_short():
    lengths = {
        f"{name(path)}:{function}": length
        for path in PYTHON + KERNELS
        for function, length in (functions if path in PYTHON else kernel_functions)(path)
    }
    assert not {one: n for one, n in lengths.items() if n > LONGER_FUNCTIONS.get(one, LINES_OF_FUNCTION)}


def test_functions_of_kernels_are_found():
    assert len([function for path in KERNELS for function in kernel_functions(path)]) > 60


def test_a_module_says_what_it_is():
    modules = [path for path in PACKAGE if path.suffix == ".py" and tree(path).body]
    assert not [name(path) for path in modules if ast.get_docstring(tree(path)) is None]


def test_the_walk_includes_nothing_of_those_who_tally():
    walk = [path for path in KERNELS if path.parent.name == "walk"]
    included = {one for path in walk for one in re.findall(r'^#include "(.*)"', path.read_text(), flags=re.MULTILINE)}
    assert included <= {f"walk/{path.name}" for path in walk}


def test_the_walk_has_few_conditionals():
    text = "".join(path.read_text() for path in KERNELS if path.parent.name == "walk")
    found = re.findall(r"^ *# *(?:if|elif).*", text, flags=re.MULTILINE)
    conditionals = [line for line in found if not re.fullmatch(r"#ifndef CLOUDTOMO_\w+_H", line)]
    assert len(conditionals) <= CONDITIONALS_OF_WALK, conditionals


def test_all_packages_and_kernels_are_installed():
    setup = configparser.ConfigParser()
    setup.read(TOP / "setup.cfg", encoding="utf-8")
    packages = set(setup["options"]["packages"].split())
    assert packages >= {module(path.parent) for path in PACKAGE if path.name == "__init__.py"}
    report = [path for path in (TOP / "cloudtomo_cl" / "report").iterdir() if path.suffix not in (".py", "")]
    assert len(report) >= 4
    data = (("cloudtomo_cl.kernels", TOP / "kernels", KERNELS), ("cloudtomo_cl.report", report[0].parent, report))
    for package, folder, needed in data:
        patterns = re.split(r"[,\s]+", setup["options.package_data"][package].strip())
        installed = {path for pattern in patterns for path in folder.glob(pattern)}
        assert not [name(path) for path in needed if path not in installed]
