"""The paper's own method as settings: ADAM with its steps, replayed paths, its stages, photons and prior weights.

Source: the supplement (monotonicity prior, Sec. 4) and the settings of its public code. What cannot be the same:

- the data term. Theirs is a plain sum of squares of radiances, ours weighs them relative to m + m_rms, and the priors'
  weights mu1 and mu2 are multiplied with our data term's unit (docs/explanation/cost.md): the numbers are the paper's,
  their weight against the images is ours;
- the residual. Ours is the product of two halves of the paths, which has no bias by their noise; theirs is of all;
- the end of a stage. Theirs ends when the mean cost of the last ten iterations changes by less than 0.001, in units of
  their cost; ours when it no longer falls beyond its noise (`has_settled`, from windows of ten iterations);
- pixels by stage, which only a figure tells: about two a voxel, as in automatic stages; the mask, which is carved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

Shape = tuple[int, int, int]
MOST_ITERATIONS, WINDOW = 1000, 10
# Factor by which the prior grows from a stage to the next; it is 1 in the last.
PRIOR_GROWTH = 5.0
START, FLOOR = 2.0, 0.01  # km^-1
# Iterations after which a step is halved: never.
_CONSTANT = 1e12


@dataclass(frozen=True)
class PaperMethod:
    """What differs between the paper's scenes.

    Attributes
    ----------
    photons : per pixel and iteration, by stage
    step_size : km^-1
    smoothness, monotonicity : mu1 and mu2
    """

    photons: tuple[int, ...]
    step_size: float
    smoothness: float
    monotonicity: float


METHODS = {
    "c": PaperMethod((3072, 1536, 768, 384, 192, 96, 48, 1024), 1.0, 0.5, 0.5),
    "f": PaperMethod((2048, 1024, 512, 256, 128, 1024), 0.3, 1.0, 1.0),
}


def grids_of_stages(stages: Sequence[tuple[int, int]], shape: Shape) -> list[Shape]:
    """Voxels of the paper's stages, given along x and z, on a grid that may be coarser than the paper's."""
    return [(min(xy, shape[0]), min(xy, shape[1]), min(z, shape[2])) for xy, z in stages]


def share_of_pixels(grid: Shape, shape: Shape) -> float:
    """About two pixels a voxel of a stage, as in automatic stages."""
    return min(1.0, 2 * max(grid) / max(shape))


def paper_settings(
    method: PaperMethod,
    stages: Sequence[tuple[int, int]],
    shape: Shape,
    photons: float = 1.0,
    iterations: int = MOST_ITERATIONS,
) -> str:
    """Tables of the run file, by smoothness alone; `prior.monotonicity` adds the other prior.

    stages : the paper's, voxels along x and z
    shape : of the finest grid; of a coarser grid than the paper's, stages that would be finer are left out
    photons : share of the paper's photons
    iterations : of a stage, at most
    """
    grids = grids_of_stages(stages, shape)
    # The first of the stages that a coarser grid makes one; the last has the paper's last.
    first = [next(n for n, grid in enumerate(grids) if grid == one) for one in dict.fromkeys(grids)]
    counts = [method.photons[n] for n in first[:-1]] + [method.photons[-1]]
    tables = [
        f"""[solver]
type = "adam"
gradient = "replay"
parametrisation = "extinction"
step_size = {method.step_size}
step_half_life = {_CONSTANT}
beta1 = 0.9
beta2 = 0.999
start = {START}
floor = {FLOOR}
iterate_average_window = 1
image_average_window = 1
[prior]
type = "smoothness"
smoothness = {method.smoothness}
monotonicity = 0.0
sparsity = 0.0
threshold = {FLOOR}
"""
    ]
    for place, (index, count) in enumerate(zip(first, counts)):
        weight = PRIOR_GROWTH ** (place + 1 - len(first))
        samples = max(2, 2 * round(count * photons / 2))
        tables.append(
            f"[[stage]]\ngrid = {[*grids[index]]}\npixels = {share_of_pixels(grids[index], shape)}\n"
            f"samples = {samples}\niterations = {iterations}\nwindow = {WINDOW}\nprior_weight = {weight}\n"
        )
    return "".join(tables)
