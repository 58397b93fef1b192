"""The exitance at points as one operation of Dr.Jit, with the derivatives of the sum behind it."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..gather.derivatives import SumDerivatives
from ..kernels.memory import columns, lanes_where, opaque, rows
from ..model.slopes import log_slopes
from .contract import Points
from .preparation import LitScene


class ExitanceOp(dr.CustomOp):
    """The exitance of one body as a function of the power of its samples, and of the logarithms that its profile depends on."""

    def eval(self, power, theta, method, lit, p, n, indirectly):
        """Sum; the values of power and theta are those that the state of the body was built for."""
        self.method, self.lit, self.p, self.indirectly = method, lit, p, indirectly
        self.names = list(theta)
        return method.sum_up(lit, p, n, indirectly)

    def forward(self):
        """Evaluate the change of the exitance."""
        theta = self.grad_in("theta")
        power = rows(self.grad_in("power"))
        steps = [np.array([v.numpy()[0] for v in theta[name]], float) for name in self.names]
        self.set_grad_out(mi.Color3f(*self._derivatives().change(self.p, steps, power if power.any() else None)))

    def backward(self):
        """Turn the gradient by the exitance into those by power and profile."""
        weights = self.grad_out() + dr.zeros(mi.Color3f, dr.width(self.p))
        theta, power = self._derivatives().gradient(self.p, mi.Point3f(weights))
        self.set_grad_in("power", mi.Color3f(*columns(np.asarray(power))))
        self.set_grad_in("theta", {name: opaque(mi.Color3f, v) for name, v in zip(self.names, theta, strict=True)})

    def _derivatives(self) -> SumDerivatives:
        medium, table = self.lit.body.medium, self.lit.state.profile
        slopes = [log_slopes(medium, table, name) for name in self.names]
        return self.method.derivatives(self.lit, slopes, self.indirectly)


def differentiated_exitance(
    method: Any, state: LitScene, points: Points, power: list[mi.Color3f], theta: list[dict[str, mi.Color3f]]
) -> mi.Color3f:
    """Do what `Method.exitance` does, with gradients to the power of the samples of each body, and to its profile."""
    result = dr.zeros(mi.Color3f, dr.width(points.p))
    for number, lit in enumerate(state.bodies, 1):
        for indirectly in (False, True):
            index = lanes_where((points.body == number) & ((points.tolerance > 1) == indirectly))
            if dr.width(index):
                p = dr.gather(mi.Point3f, points.p, index)
                n = dr.gather(mi.Normal3f, points.n, index)  # no profile that has derivatives reads them
                dr.eval(p, n)
                value = dr.custom(ExitanceOp, power[number - 1], theta[number - 1], method, lit, p, n, indirectly)
                dr.scatter(result, value, index)
    return result
