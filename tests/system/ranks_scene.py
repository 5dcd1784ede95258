"""A small scene, and digests of all that ranks share when it is rendered, differentiated and recovered."""

import hashlib
from dataclasses import replace

import numpy as np

import cloudtomo_cl as ct
from cloudtomo_cl.transport.jacobian_average import JacobianAverage
from cloudtomo_cl.transport.table_builder import RadianceTableBuilder
from cloudtomo_cl.transport.table_gradient import TableGradient

GRID = ct.Grid(shape=(6, 6, 5), spacing=(0.1, 0.1, 0.1))
SCENE = ct.Scene(grid=GRID, sun=ct.Sun(zenith=30.0))
# 9 x 7 pixels are blocks of 4 x 4 and less; a list of rays has blocks of one.
RING = ct.RingOfViews(target=GRID.centre, height=2.2, radius=1.2, count=2, field_of_view=24.0, pixels=(9, 7)).views()
VIEWS = (*RING, ct.RayView([(0.3, 0.3, 1.0), (0.2, 0.4, 1.0)], [(0, 0.1, -1), (0.1, 0, -1)], pixels=(2, 1)))
STAGES = (ct.Stage(grid=(3, 3, 3), iterations=1, samples=4), ct.Stage(grid=GRID.shape, iterations=3, samples=4))


def extinction():
    """km^-1; without and with droplets side by side."""
    values = np.random.default_rng(4).gamma(0.5, 10.0, GRID.shape).astype(np.float32)
    values[0] = 0
    return values


def digest(*arrays):
    """Of arrays on host or device."""
    held = [array.get() if hasattr(array, "get") else np.asarray(array) for array in arrays]
    return hashlib.sha256(b"".join(array.tobytes() for array in held)).hexdigest()[:16]


def of_rendering(rendering):
    return digest(rendering.mean, rendering.standard_error, rendering.halves) + repr(rendering.audit)


def forward(device):
    """Digests of renderings, fluxes, and gradients by replay."""
    operator = ct.RadianceOperator(SCENE, VIEWS, device)
    rendering = operator.render(extinction(), 16, seed=1, store_paths=True)
    yield "rendering", of_rendering(rendering)
    adjoint = np.random.default_rng(1).normal(size=(len(operator.pixels), 2))
    yield "replay gradient", digest(operator.gradient(rendering, adjoint))
    yield "adaptive rendering", of_rendering(ct.render_to_error(operator, extinction(), 0.1, seed=2))
    one = operator.of_pixels(operator.pixels[:1]).render(extinction(), 16, seed=1)
    yield "fewer pixels than ranks", of_rendering(one)
    periodic = replace(SCENE, boundary=ct.Boundary("periodic"), surface=ct.Surface(0.2))
    fluxes = ct.FluxOperator(periodic, device).compute(extinction(), 5000, seed=4)
    parts = (fluxes.reflected, fluxes.direct, fluxes.diffuse, fluxes.absorbed)
    yield "fluxes", digest(*[array for part in parts for array in (part.value, part.standard_error)])


def derivatives(device):
    """Digests of the radiance table and of a Jacobian, with every product."""
    mask = np.ones(GRID.shape, bool)
    mask[0, :3] = False
    operator = ct.RadianceOperator(SCENE, VIEWS, device, mask=mask)
    random, values = np.random.default_rng(5), np.where(mask, extinction(), 0)
    rendering = operator.render(values, 8, seed=1, store_paths=True)
    by_table = TableGradient(operator)
    change = device.array(np.where(mask, random.normal(size=mask.shape), 0).astype(np.float32))
    adjoint = random.normal(size=(len(operator.pixels), 2))
    for turn in range(2):
        yield f"table gradient {turn}", digest(*by_table.gradient(rendering, adjoint, change))
    table = RadianceTableBuilder(operator).at(rendering)
    yield "table", digest(table.diffuse, table.sunlight)
    sums = JacobianAverage(operator)
    sums.add(rendering, 1.0)
    sums.add(operator.render(values / 2, 4, seed=1, stream=2, store_paths=True), 0.5)
    x, y = random.normal(size=(mask.sum(), 3)), random.normal(size=(len(operator.pixels), 3))
    jacobian = sums.jacobian
    yield "products", digest(jacobian @ x[:, 0], jacobian.matmat(x))
    yield "transposed products", digest(jacobian.T @ y[:, 0], jacobian.rmatmat(y))
    yield "curvature", digest(jacobian.curvature(y[:, 0] ** 2))


def recovery(device, solver=None, stages=STAGES, **options):
    """A recovery from rendered images, as `reconstruct` gives it; with smoothness, whose steps take few products."""
    operator = ct.RadianceOperator(SCENE, RING, device)
    measured = ct.Measurements.rendered(operator, operator.render(extinction(), 16, seed=3))
    solver = solver or ct.GaussNewton(image_samples=1, inner_iterations=5)
    options = {"prior": ct.Prior(), **options}
    return ct.reconstruct(
        SCENE, measured, stages, solver=solver, device=device, seed=2, uncertainty=2, truth=extinction(), **options
    )


def of_recovery(result):
    """Digest of all but the seconds."""
    error = () if result.standard_error is None else (result.standard_error,)
    history = [(record.paths, record.cost, record.prior, record.epsilon) for record in result.history]
    return digest(result.extinction, result.mask, *error, np.array(history))


def recoveries(device):
    """Digests of recoveries by all kinds of solvers."""
    yield "Gauss-Newton", of_recovery(recovery(device))
    once = (replace(STAGES[1], iterations=1),)
    yield "Gauss-Newton with patches", of_recovery(recovery(device, stages=once, prior=ct.PatchPrior()))
    yield "Adam", of_recovery(recovery(device, ct.Adam()))
    yield "Adam by replay", of_recovery(recovery(device, ct.Adam(gradient="replay")))


def everything(device):
    """All digests by name."""
    return dict([*forward(device), *derivatives(device), *recoveries(device)])
