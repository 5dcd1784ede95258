"""Ranks that share a computation: processes under MPI, or threads with a device each."""
