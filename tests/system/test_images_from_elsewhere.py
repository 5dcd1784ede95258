"""The how-to for images from elsewhere: its example runs as it stands, and recovers the cloud."""

import re
from pathlib import Path

import cloudtomo_cl as ct

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "images-from-elsewhere.md"


def test_the_example_recovers_the_cloud_from_poses_and_reflectances(tmp_path, monkeypatch):
    """eps is 0.78 and delta 0.20; with reflectance factors taken for radiances 2.3 and 1.6."""
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"<!-- tested .*?```python\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)
    # The limit is for readers; so few iterations show that the images were understood.
    assert "time_limit=30" in example
    example = example.replace("time_limit=30", "solver=ct.GaussNewton(iterations=3, inner_iterations=15)")
    names = {}
    exec(compile(example, str(PAGE), "exec"), names)
    recovered, truth = names["result"].extinction, names["truth"]
    assert ct.epsilon(recovered, truth) < 1
    assert abs(ct.delta(recovered, truth)) < 0.5
