"""Ends small runs of every command at random moments, in all ways that programs are ended, and looks at what is left.

    python scripts/kill_and_resume.py [--kills 200] [--seed 0] [--folder DIR] [--table FILE.md]

Half of the moments are drawn over the time that a command takes, half lie within milliseconds of a file that is being
written. Afterwards every file must be the old one or the whole new one, with the bits of a run that nobody disturbed;
files of others must be untouched; nothing may hang; and the next run must end as if nothing had been, with nothing half
left in the folder. A reconstruction goes on with --resume until it ends. Exit status 0 if all of that is so.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import xarray as xr

import cloudtomo_cl as ct

SCENE = """
[cloud]
file = "cloud.nc"
[sun]
zenith = 30.0
[boundary]
horizontal = "periodic"
[[view]]
type = "orthographic"
zenith = 0.0
width = 1.2
pixels = [10, 10]
[[view]]
type = "orthographic"
zenith = 50.0
width = 1.2
pixels = [10, 10]
[[view]]
type = "orthographic"
zenith = 50.0
azimuth = 180.0
width = 1.2
pixels = [10, 10]
"""
# Checkpoints as often as it goes.
RUN = """
[measurements]
file = "images.nc"
[truth]
file = "cloud.nc"
[run]
seed = 3
checkpoint_interval = 0.0
[[stage]]
grid = [3, 3, 3]
pixels = 0.5
samples = 8
iterations = 6
[[stage]]
grid = [6, 6, 6]
samples = 8
iterations = 8
"""
# The program, with fewer paths for the report's images.
PROGRAM = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.SIG_DFL); "
    "from cloudtomo_cl.commands import modelled; modelled.PATHS = modelled.FEWEST_SAMPLES = 16; "
    "from cloudtomo_cl.__main__ import main; main()"
)
COMMANDS = {
    "cloud": "cloud --generate cumulus --shape 6 6 6 --spacing 0.1 0.1 0.1 --output made_cloud.nc --overwrite",
    "cloud --png": "cloud cloud.nc --png made_cloud.png --overwrite",
    "mie --png": "mie --wavelength 2000 --effective-radius 2 3 --output made_mie.nc --png made_mie.png --overwrite",
    "prior": "prior learn cloud.nc --components 1 --output made_prior.nc --overwrite",
    "init": "init reconstruct --output made_run.toml --overwrite",
    "render --png": "render scene.toml --samples 512 --output made_images.nc --png previews --overwrite",
    "flux": "flux scene.toml --photons 300000 --output made_fluxes.nc --overwrite",
    "validate": "validate --only slab --photons 1000 --output made_table.csv --overwrite",
    "reconstruct": "reconstruct run.toml --no-report --resume --output run",
    "report": "report finished",
}
# Reconstructions are struck most often: they write most.
WEIGHTS = {"reconstruct": 6, "report": 2, "render --png": 2}
WAYS = {
    "KILL": (-signal.SIGKILL,),
    "TERM": (143, -signal.SIGTERM),
    "INT": (130, -signal.SIGINT),
    "INT twice": (130, -signal.SIGINT),
    "HUP": (129, -signal.SIGHUP),
    "STOP, CONT": (0,),
    "terminal closed": (129, -signal.SIGHUP),
}
OTHERS = (
    "notes.txt", ".draft.partial", "figures/mine.png", "run/figures/mine.pdf", "run/.draft.partial", "finished/mine.png"
)  # fmt: skip
_HANGS = 90.0
_INTERPRETER = "init_import_site"


def program(words: str) -> list[str]:
    return [sys.executable, "-c", PROGRAM, *words.split()]


def is_whole(path: Path) -> bool:
    """Whether a picture, a page or a list is complete; by its end, for some hold the time."""
    ends = {".png": b"IEND\xaeB`\x82", ".pdf": b"%%EOF\n", ".html": b"</html>\n", ".json": b"\n", ".toml": b"\n"}
    return path.read_bytes().endswith(ends[path.suffix])


def same(path: Path, expected: Path) -> bool:
    """Whether a file has the numbers of the undisturbed one, or is complete where that is all there is to compare."""
    if path.suffix == ".nc":
        with xr.open_dataset(path) as one, xr.open_dataset(expected) as other:
            return set(one) == set(other) and all(one[name].equals(other[name]) for name in one)
    if path.suffix == ".csv":
        return timeless_table(path) == timeless_table(expected)
    if path.suffix in (".png", ".toml"):
        return path.read_bytes() == expected.read_bytes()
    return is_whole(path)


def timeless_table(table: Path) -> list[str]:
    """The lines of a table of `validate` without its notes, which tell the day and the time that it took."""
    return [line for line in table.read_text().splitlines() if not line.startswith("#")]


def timeless(history: Path) -> list[list[str]]:
    """The history without its seconds."""
    header, *lines = [line.split(",") for line in history.read_text().splitlines()]
    place = header.index("seconds")
    return [line[:place] + line[place + 1 :] for line in lines]


@dataclass
class Bench:
    """A folder in which commands are struck.

    Attributes
    ----------
    folder, expected : where commands run, and copies of what they write undisturbed
    seconds : that a command takes undisturbed
    counts : of (command, way) and what came of it
    wrong : sentences about what should not be
    """

    folder: Path
    expected: Path
    rng: random.Random
    seconds: dict[str, float] = field(default_factory=dict)
    counts: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    finished_runs: int = 0

    def prepare(self) -> None:
        """Inputs, what every command writes undisturbed, and files of others."""
        grid = ct.Grid(shape=(6, 6, 6), spacing=(0.16, 0.16, 0.16))
        ct.write_extinction(self.folder / "cloud.nc", grid, ct.cumulus(grid, seed=3, peak=40.0))
        (self.folder / "scene.toml").write_text(SCENE)
        (self.folder / "run.toml").write_text(RUN)
        self.run("render scene.toml --samples 256 --output images.nc")
        for name, words in COMMANDS.items():
            if name == "report":
                shutil.copytree(self.folder / "run", self.folder / "finished")
            start = time.monotonic()
            self.run(words)
            self.seconds[name] = time.monotonic() - start
            for output in self.outputs(name):
                kept = self.expected / name / output.relative_to(self.folder)
                kept.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(output, kept)
        shutil.rmtree(self.folder / "run")
        for name in OTHERS:
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            (self.folder / name).write_text("not ours")

    def run(self, words: str) -> None:
        """A command that must end by itself."""
        done = subprocess.run(program(words), cwd=self.folder, capture_output=True, text=True, timeout=_HANGS)
        if done.returncode:
            self.wrong.append(f"{words}: exit status {done.returncode}: {done.stderr}")

    def outputs(self, name: str) -> list[Path]:
        """What a command writes."""
        if name in ("reconstruct", "report"):
            folder = self.folder / COMMANDS[name].split()[-1]
            paths = [path for pattern in ("*.nc", "*.html", "figures/*.p*") for path in folder.glob(pattern)]
        else:
            paths = [self.folder / word for word in COMMANDS[name].split() if word.startswith("made_")]
            paths += sorted(self.folder.glob("previews/*.png")) if "previews" in COMMANDS[name] else []
        names = {path: path.relative_to(self.folder).as_posix() for path in paths if path.suffix != ".partial"}
        return [path for path, name in names.items() if name not in OTHERS]

    def strike(self, name: str, way: str) -> None:
        """Starts a command and ends it; looks at what is left."""
        terminal, process = start(program(COMMANDS[name]), self.folder, way == "terminal closed")
        in_a_write = self.wait_for_the_moment(process, terminal, name)
        struck = process.poll() is None
        if struck:
            end(process, terminal, way, self.rng)
            terminal = None if way == "terminal closed" else terminal
        try:
            process.wait(_HANGS)
        except subprocess.TimeoutExpired:
            self.wrong.append(f"{name}, {way}: hangs")
            process.kill()
            process.wait()
        if terminal is not None:
            os.close(terminal)
        # A run may have come to its end just before it was struck.
        if process.returncode not in (0, *WAYS[way]):
            said = (self.folder / "said").read_text() if (self.folder / "said").exists() else ""
            # Before any file of ours is read, Ctrl-C meets the interpreter alone, whose answer this is.
            if not (way.startswith("INT") and _INTERPRETER in said):
                self.wrong.append(f"{name}, {way}: exit status {process.returncode}: {said}")
        kind = "not struck" if not struck else "in a write" if in_a_write else "elsewhere"
        self.counts[name, way, kind] += 1
        self.look(name, way)

    def wait_for_the_moment(self, process: subprocess.Popen[bytes], terminal: int | None, name: str) -> bool:
        """Until a random moment, or until a file is being written; whether it is one of these."""
        in_a_write, end = self.rng.random() < 0.5, time.monotonic() + self.rng.uniform(0, self.seconds[name])
        skipped = self.rng.randrange(20 if name == "reconstruct" else 3)
        seen: set[str] = set()

        def reached() -> bool:
            if not in_a_write:
                return time.monotonic() > end
            folder = self.folder / (COMMANDS[name].split()[-1] if name in ("reconstruct", "report") else "")
            for place in (folder, folder / "figures", folder / "previews"):
                seen.update(str(path) for path in place.glob(".*-*.partial"))
            return len(seen) > skipped + self.left_before

        self.left_before = len(partials(self.folder))
        while process.poll() is None and not reached():
            drain(terminal)
            time.sleep(0.0005)
        time.sleep(self.rng.uniform(0, 0.004))
        return in_a_write and bool(seen)

    def look(self, name: str, way: str) -> None:
        """Every file is whole and has its bits; those of others are as they were."""
        for path in self.outputs(name):
            # What was interrupted is of an earlier iteration: that it can be read counts.
            try:
                if name == "reconstruct" and path.suffix == ".nc":
                    fine = ct.read_measurements(path) is not None and ct.read_extinction(path) is not None
                else:
                    kept = self.expected / name / path.relative_to(self.folder)
                    fine = is_whole(path) if name == "reconstruct" or not kept.exists() else same(path, kept)
            except Exception as error:
                fine = False
                self.wrong.append(f"{path.name}: {error}")
            if not fine:
                self.wrong.append(f"{name}, {way}: {path.name} is not whole, or has other bits")
        for other in OTHERS:
            if not (self.folder / other).exists() or (self.folder / other).read_text() != "not ours":
                self.wrong.append(f"{name}, {way}: {other}, a file of others, was touched")

    def finish(self, name: str) -> None:
        """The command runs undisturbed after all; nothing may be left of the struck ones."""
        self.run(COMMANDS[name])
        for path in self.outputs(name):
            kept = self.expected / name / path.relative_to(self.folder)
            if not same(path, kept):
                self.wrong.append(f"{name}: in the end {path.name} has other bits")
        if name == "reconstruct":
            folder = self.folder / "run"
            expected = self.folder / "finished" / "history.csv"
            if timeless(folder / "history.csv") != timeless(expected):
                self.wrong.append("reconstruct: in the end the history is another one")
            self.finished_runs += 1
            for path in folder.iterdir():
                if path.is_file() and f"run/{path.name}" not in OTHERS:
                    path.unlink()
            for path in self.outputs(name):
                path.unlink()


def partials(folder: Path) -> list[Path]:
    """What is being written, or was."""
    return [path for path in folder.rglob(".*-*.partial")]


def start(words: list[str], folder: Path, with_terminal: bool) -> tuple[int | None, subprocess.Popen[bytes]]:
    """A process, and its terminal if it shall have one of its own."""
    if not with_terminal:
        quiet = subprocess.DEVNULL
        with open(folder / "said", "wb") as said:
            return None, subprocess.Popen(words, cwd=folder, stdin=quiet, stdout=quiet, stderr=said)
    import fcntl
    import pty
    import termios

    terminal, inside = pty.openpty()
    os.set_blocking(terminal, False)

    def take() -> None:
        os.setsid()
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)

    process = subprocess.Popen(words, cwd=folder, stdin=inside, stdout=inside, stderr=inside, preexec_fn=take)
    os.close(inside)
    return terminal, process


def drain(terminal: int | None) -> None:
    """Reads what is on a terminal: one that is full would stop the program."""
    if terminal is not None:
        with contextlib.suppress(OSError):
            os.read(terminal, 65536)


def end(process: subprocess.Popen[bytes], terminal: int | None, way: str, rng: random.Random) -> None:
    """Ends a process in one of the ways."""
    if way == "terminal closed":
        assert terminal is not None
        os.close(terminal)
    elif way == "STOP, CONT":
        process.send_signal(signal.SIGSTOP)
        time.sleep(0.1)
        process.send_signal(signal.SIGCONT)
    else:
        name, _, twice = way.partition(" ")
        process.send_signal(getattr(signal, f"SIG{name}"))
        if twice:
            time.sleep(rng.uniform(0, 0.1))
            process.send_signal(getattr(signal, f"SIG{name}"))


def table(bench: Bench) -> str:
    """Kills by command and way, of them in a write."""
    lines = ["| | " + " | ".join(WAYS) + " |", "|---|" + "---:|" * len(WAYS)]
    for name in COMMANDS:
        cells = []
        for way in WAYS:
            all_, inside = (
                sum(bench.counts[name, way, kind] for kind in kinds)
                for kinds in (("in a write", "elsewhere"), ("in a write",))
            )
            cells.append(f"{all_} ({inside})" if all_ else "0")
        lines.append(f"| `{name}` | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--folder", type=Path, help="keep the runs here")
    parser.add_argument("--table", type=Path, help="where the table goes, Markdown")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        (folder / "work").mkdir(parents=True)
        bench = Bench(folder / "work", folder / "expected", random.Random(options.seed))
        bench.prepare()
        begin: Callable[[], float] = time.monotonic
        since, done = begin(), 0
        names = [name for name in COMMANDS for _ in range(WEIGHTS.get(name, 1))]
        while done < options.kills and not bench.wrong:
            name, way = bench.rng.choice(names), bench.rng.choice(list(WAYS))
            bench.strike(name, way)
            done = sum(count for (_, _, kind), count in bench.counts.items() if kind != "not struck")
            # Now and then a reconstruction comes to its end, and another one is begun.
            if name == "reconstruct" and bench.rng.random() < 0.08:
                bench.finish(name)
            if done % 20 == 0:
                print(f"{done} kills in {begin() - since:.0f} s", flush=True)
        for name in COMMANDS:
            bench.finish(name)
        left = [str(path.relative_to(bench.folder)) for path in partials(bench.folder)]
        if left:
            bench.wrong.append(f"left in the end: {', '.join(left)}")
        inside = sum(count for (_, _, kind), count in bench.counts.items() if kind == "in a write")
        text = f"{done} kills (seed {options.seed}), {inside} during a write, {bench.finished_runs} reconstructions"
        print(table(bench), text, *bench.wrong, sep="\n")
        if options.table is not None:
            options.table.write_text(f"{table(bench)}\n\n{text}: {len(bench.wrong)} faults\n")
        return 1 if bench.wrong else 0


if __name__ == "__main__":
    sys.exit(main())
