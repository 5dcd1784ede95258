"""Radiative transfer on a device: radiances, their derivatives, fluxes, the energy budget."""
