"""The Python examples of the documentation run as they stand."""

import re
from pathlib import Path

README = Path(__file__).parents[2] / "README.md"
PYTHON = README.parent / "docs" / "python.md"


def test_python_example_recovers_a_cloud(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", README.read_text(), flags=re.DOTALL)
    exec(compile(example, str(README), "exec"), {})
    assert re.fullmatch(r"eps [\d.]+, largest extinction \d+ km\^-1\n", capsys.readouterr().out)


def test_scipy_example_comes_closer_to_the_cloud(capsys):
    (example,) = re.findall(r"<!-- tested .*?```python\n(.*?)```", PYTHON.read_text(), flags=re.DOTALL)
    exec(compile(example, str(PYTHON), "exec"), {})
    start, end = re.fullmatch(r"eps ([\d.]+) at the start, ([\d.]+) in the end\n", capsys.readouterr().out).groups()
    assert float(end) < 0.8 < float(start)
