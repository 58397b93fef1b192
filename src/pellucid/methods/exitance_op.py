"""The exitance at points as one operation of Dr.Jit, with the derivatives of the sum behind it."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..gather.derivatives import SumDerivatives
from ..kernels.memory import columns, lanes_where, opaque, rows
from ..model.slopes import BOUND
from .contract import Points
from .preparation import LitScene


class ExitanceOp(dr.CustomOp):
    """The exitance of one body as a function of the power of its samples, and of the logarithms that its profile depends on."""

    def eval(self, power, theta, method, lit, p, n, indirectly):
        """Sum; the values of power and theta are those that the state of the body was built for."""
        self.method, self.lit, self.p, self.n, self.indirectly = method, lit, p, n, indirectly
        self.names = list(theta)  # the bound of mu comes last, where there is one
        return method.sum_up(lit, p, n, indirectly)

    def forward(self):
        """Evaluate the change of the exitance."""
        theta = self.grad_in("theta")
        given = rows(self.grad_in("power"))
        power = given if given.any() else None
        steps = [np.array([v.numpy()[0] for v in theta[name]], float) for name in self.names]
        self.set_grad_out(mi.Color3f(*self._derivatives().change(self.p, steps, power, self.n)))

    def backward(self):
        """Turn the gradient by the exitance into those by power and profile."""
        weights = self.grad_out() + dr.zeros(mi.Color3f, dr.width(self.p))
        theta, power = self._derivatives().gradient(self.p, mi.Point3f(weights), n=self.n)
        self.set_grad_in("power", mi.Color3f(*columns(np.asarray(power))))
        self.set_grad_in("theta", {name: opaque(mi.Color3f, v) for name, v in zip(self.names, theta, strict=True)})

    def _derivatives(self) -> SumDerivatives:
        names = [name for name in self.names if name != BOUND]
        return self.method.derivatives(self.lit, names, self.indirectly)


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
                n = dr.gather(mi.Normal3f, points.n, index) * dr.opaque(mi.Float, lit.samples.outside)
                dr.eval(p, n)
                value = dr.custom(ExitanceOp, power[number - 1], theta[number - 1], method, lit, p, n, indirectly)
                dr.scatter(result, value, index)
    return result
