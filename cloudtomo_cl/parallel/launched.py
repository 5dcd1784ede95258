"""Whether a launcher of MPI has started this process, and with how many others. Imports nothing slow."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from cloudtomo_cl.errors import MissingPackageError, SettingsError

if TYPE_CHECKING:
    from cloudtomo_cl.parallel.ranks import Ranks

# Environment variables in which MPI's launchers tell each process how many there are, and which one it is.
_SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS")
_NUMBERS = ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK", "SLURM_PROCID")


def launched_size() -> int:
    """Number of processes that MPI's launcher has started, this one included; 1 without a launcher."""
    return max((int(os.environ[name]) for name in _SIZES if os.environ.get(name, "").isdigit()), default=1)


def launched_rank() -> int:
    """Number of this process among them, from the launcher; 0 without one. MPI is neither asked nor imported."""
    numbers = [int(os.environ[name]) for name in _NUMBERS if os.environ.get(name, "").isdigit()]
    return numbers[0] if numbers and launched_size() > 1 else 0


def launched_ranks() -> Ranks:
    """The processes that `mpiexec` or `srun` has started; without them, and without mpi4py, this one alone.

    Raises
    ------
    MissingPackageError : there are several, and mpi4py is not installed
    SettingsError : there are several, and MPI knows of one
    """
    from cloudtomo_cl.parallel.ranks import ALONE

    size = launched_size()
    if size == 1:
        return ALONE
    try:
        from cloudtomo_cl.parallel.mpi import MPIRanks, world
    except (ImportError, RuntimeError) as error:
        raise MissingPackageError(
            f"{size} processes were started together, which needs mpi4py and a library of MPI ({error}): "
            "pip install 'cloudtomo-cl[mpi]', or start one process"
        ) from None
    communicator, library = world()
    if communicator.Get_size() == 1:
        raise SettingsError(
            f"{size} processes were started together, but MPI ({library}) knows of one: start them with the mpiexec "
            "of the library that mpi4py uses (with srun: --mpi=pmix or pmi2)"
        )
    return MPIRanks(communicator)
