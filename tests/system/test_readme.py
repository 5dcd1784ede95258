"""The README's Python example runs as it stands."""

import re
from pathlib import Path

README = Path(__file__).parents[2] / "README.md"


def test_python_example_recovers_a_cloud(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", README.read_text(), flags=re.DOTALL)
    exec(compile(example, str(README), "exec"), {})
    assert re.fullmatch(r"eps [\d.]+, largest extinction \d+ km\^-1\n", capsys.readouterr().out)
