"""Steps of stochastic descent, projected onto extinctions at or above a floor."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from cloudtomo_cl.device import Device, device_errors
from cloudtomo_cl.grid import Count
from cloudtomo_cl.scene import NotNegative, Positive

Decay = Annotated[float, Field(ge=0, lt=1)]


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Optimizer:
    """How an iteration moves the extinction.

    Attributes
    ----------
    type : "gauss-newton" (the derivatives of all pixels are kept and a quadratic model of the cost is
        minimised), "adam" (Kingma and Ba 2015) or "sgd", plain gradient descent. All below but
        `iterations`, `start` and `floor` is for one of them
    iterations : on the finest of the automatic stages, at most; by default 30, of descents 600. A run that
        has done them goes on with more by `--resume`, unless its cost has settled
    image_samples : Gauss-Newton: paths for the images, times those for the derivatives
    damping : Gauss-Newton: of the first steps, in shares of the data term's own curvature; it halves
        from step to step, down to a tenth
    inner_iterations : Gauss-Newton: of the minimisation of the quadratic model
    gradient : "field", by the radiance that all paths together find in a voxel (little noise, no
        1 / extinction), or "replay", the source's score function of each path by itself
    step : ADAM: length of a step in the variable; SGD: factor of the gradient
    variable : "extinction" (km^-1), or its "square-root" (km^-1/2), in which thin voxels take
        smaller steps
    start : extinction inside the mask before the first stage, km^-1
    floor : least extinction inside the mask, km^-1; the gradient by replay needs it above 0
    decay1, decay2 : of ADAM's moments
    halving : iterations of a stage after which the step is half of what it began with
        (step / (1 + iteration / halving)); none: constant
    averaging : the estimate is a running mean of the extinction over about so many iterations
    image_memory : iterations over which modelled images are averaged into the residual; 1 is
        the residual of crossed halves. With gradient "field" the images are carried along with the
        extinction; with "replay" they lag behind, and 20 is better
    """

    type: Literal["gauss-newton", "adam", "sgd"] = "gauss-newton"
    iterations: Count | None = None
    image_samples: Annotated[int, Field(ge=0)] = 10
    damping: NotNegative = 0.1
    inner_iterations: Count = 40
    gradient: Literal["field", "replay"] = "field"
    step: Positive = 0.3
    variable: Literal["extinction", "square-root"] = "square-root"
    start: Positive = 2.0
    floor: NotNegative = 0.01
    decay1: Decay = 0.9
    decay2: Decay = 0.999
    halving: Positive | None = 100.0
    averaging: Count = 20
    image_memory: Count = 100


class Descent:
    """An optimizer's state on a device. Its moments start at zero: a new stage, a new Descent.

    Parameters
    ----------
    extinction : where to start, km^-1, shape of the grid
    mask : bool, same shape; voxels outside stay 0

    Attributes
    ----------
    extinction : on the device, float32, km^-1; changed by every step
    """

    @device_errors("preparing the descent")
    def __init__(self, optimizer: Optimizer, extinction: np.ndarray, mask: np.ndarray, device: Device) -> None:
        import pyopencl.array as cl_array

        self.optimizer = optimizer
        self.device = device
        start = np.where(mask, np.maximum(extinction, optimizer.floor), 0.0)
        self.extinction = cl_array.to_device(device.queue, np.ascontiguousarray(start, np.float32))
        self.steps = 0
        self._mean = self.extinction.copy()
        self._before = self.extinction.copy()
        self._mask = cl_array.to_device(device.queue, np.ascontiguousarray(mask, np.uint8))
        self._moments = [cl_array.zeros_like(self.extinction) for _ in range(2 if optimizer.type == "adam" else 0)]
        self._kernel = device.kernel("optimizer", f"{optimizer.type}_step")

    @device_errors("reading the extinction")
    def estimate(self) -> np.ndarray:
        """The running mean of the extinction, km^-1."""
        return self._mean.get()

    @device_errors("reading the extinction")
    def state(self) -> dict[str, np.ndarray]:
        """All that a step changes, as arrays on the host."""
        moments = {f"moment{order}": moment.get() for order, moment in enumerate(self._moments)}
        own = {"extinction": self.extinction.get(), "mean": self._mean.get(), "steps": np.array(self.steps)}
        own["before"] = self._before.get()
        return own | moments

    @device_errors("restoring the extinction")
    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Goes on from what `state` gave."""
        self.extinction.set(state["extinction"])
        self._mean.set(state["mean"])
        self._before.set(state["before"])
        for order, moment in enumerate(self._moments):
            moment.set(state[f"moment{order}"])
        self.steps = int(state["steps"])

    @property
    def change(self) -> Any:
        """What the last step changed the extinction by, on the device, km^-1."""
        return self.extinction - self._before

    @device_errors("the descent's step")
    def step(self, gradient: Any) -> None:
        """One step against a gradient on the device, cost per km^-1."""
        self._before = self.extinction.copy()
        optimizer = self.optimizer
        length = optimizer.step / (1 + self.steps / optimizer.halving) if optimizer.halving else optimizer.step
        self.steps += 1
        arguments = [
            gradient.size, self.extinction, self._mask, gradient, length,
            optimizer.variable == "square-root", optimizer.floor,
        ]  # fmt: skip
        if optimizer.type == "adam":
            decays = (optimizer.decay1, optimizer.decay2)
            arguments += [*self._moments, *decays, *(1 / (1 - decay**self.steps) for decay in decays)]
        self.device.launch(self._kernel, gradient.size, *arguments)
        self._mean += (self.extinction - self._mean) * np.float32(1 / min(self.steps, optimizer.averaging))
