"""The data term of a model whose derivatives are an array."""

from cloudtomo_cl.inversion.vectors import Vectors


class DenseTerm:
    """1/2 r^T W C r of residuals r; see `Term`."""

    quadratic = True

    def __init__(self, device, jacobian, weights, correct=lambda residual: residual):
        self.jacobian, self.weights, self.correct = jacobian, weights, correct
        self.vectors = Vectors(device, jacobian.shape[1])

    def slope(self, residual):
        return self.jacobian.T @ (self.weights * self.correct(residual))

    def add_product(self, x, result):
        self.vectors.add(1.0, self.vectors.of(self.slope(self.jacobian @ x.get().astype(float))), result)
