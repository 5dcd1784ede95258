"""Programs and kernels that are built from the shipped sources, each once."""

from __future__ import annotations

import shutil
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cloudtomo_cl.errors import BuildError
from cloudtomo_cl.opencl import kernel_cache
from cloudtomo_cl.opencl.driver import device_errors, import_pyopencl
from cloudtomo_cl.opencl.parameters import KERNELS, Kernel


def kernels_folder() -> Path:
    """Where the kernels' sources are: in the installed package, or beside it in a checkout."""
    package = Path(__file__).parent.parent
    installed = package / "kernels"
    return installed if installed.is_dir() else package.parent / "kernels"


@contextmanager
def _include_folders() -> Iterator[list[str]]:
    """Folders in which compilers find the headers; a copy where a space in the path would confuse PoCL's compiler."""
    import pyopencl

    ours = kernels_folder()
    # pyopencl adds a folder of headers to the options itself, but PoCL cannot read a path with a space.
    theirs = Path(pyopencl.__file__).parent / "cl"
    folders = [folder for folder in (ours, theirs) if " " in str(folder)]
    if not folders or " " in tempfile.gettempdir():
        yield [str(ours)]
        return
    with tempfile.TemporaryDirectory(prefix="cloudtomo-") as copy:
        for folder in {ours, *folders}:
            shutil.copytree(folder, copy, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
        yield [copy]


def compiler_options(device: Any) -> tuple[str, ...]:
    """Compiler options: no warnings on the user's terminal; on GPUs divisions and square roots rounded as on CPUs."""
    cl = import_pyopencl()
    options: tuple[str, ...] = ("-cl-std=CL1.2", "-w")
    exact = bool(device.single_fp_config & cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT)
    if exact and device.type & cl.device_type.GPU:
        options += ("-cl-fp32-correctly-rounded-divide-sqrt",)
    return options


class Programs:
    """What has been built for a device. Threads share it under the device's lock.

    Parameters
    ----------
    context : of OpenCL
    device_name : for messages
    """

    def __init__(self, context: Any, device_name: str) -> None:
        self._context, self._device_name = context, device_name
        self._programs: dict[str, Any] = {}
        self._kernels: dict[tuple[str, str, tuple[str, ...]], Kernel] = {}

    def __iter__(self) -> Iterator[Any]:
        """The programs so far."""
        return iter(self._programs.values())

    def built(self, source: str, preamble: str, options: tuple[str, ...]) -> Any:
        """A program of OpenCL C that may include the shipped headers.

        Parameters
        ----------
        source : which program it is
        preamble : what comes before it
        options : of the compiler

        Raises
        ------
        BuildError : with device, options and the compiler's log
        """
        if source in self._programs:
            return self._programs[source]
        cl = import_pyopencl()
        kernel_cache.check()
        with _include_folders() as folders:
            given = [*options, *(word for folder in folders for word in ("-I", folder))]
            try:
                with warnings.catch_warnings():
                    # A compiler's warnings about a build that succeeded do not concern users.
                    warnings.simplefilter("ignore", cl.CompilerWarning)
                    self._programs[source] = cl.Program(self._context, f"{preamble}\n{source}").build(given)
            except cl.Error as error:
                space = any(" " in option for option in given)
                hint = "\na space in the folder's name may be the cause: install elsewhere" if space else ""
                raise BuildError(
                    f"device {self._device_name}: a kernel did not build; choose another device (`cloudtomo devices` "
                    f"lists them) or report this text\noptions: {' '.join(given)}\n{error}{hint}"
                ) from None
        return self._programs[source]

    def kernel(
        self, file: str, name: str, features: tuple[str, ...], preamble: str, options: tuple[str, ...]
    ) -> Kernel:
        """A kernel of a shipped file, whose program is built with some macros; otherwise as `built`."""
        if (file, name, features) not in self._kernels:
            source = "".join(f"#define {feature}\n" for feature in features) + f'#include "{file}.cl"\n'
            program = self.built(source, preamble, options)
            with device_errors(f"making the kernel {name}"):
                kernel = import_pyopencl().Kernel(program, name)
                self._kernels[file, name, features] = Kernel(kernel, name, KERNELS[name])
        return self._kernels[file, name, features]
