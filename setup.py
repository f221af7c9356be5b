"""Builds the native rasteriser with the package; everything else about the package is in pyproject.toml.

Without a C++ compiler the installation succeeds with a loud message: the package then compiles at first use if a
compiler has come by, and renders with the slow reference if none has.
"""

import importlib.util
import sys
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

# The file, not the package: importing soar.raster needs torch, which a build environment does not have.
_spec = importlib.util.spec_from_file_location(
    "soar_raster_build", Path(__file__).parent / "soar" / "raster" / "build.py"
)
build = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(build)


class BuildNative(build_ext):
    """Compiles soar/raster/native by the same function that first use would."""

    def get_ext_filename(self, fullname: str) -> str:
        *packages, _ = fullname.split(".")
        return str(Path(*packages, build.installed_path().name))

    def build_extension(self, extension: Extension) -> None:
        try:
            build.compile_library(build.compiler(), Path(self.get_ext_fullpath(extension.name)).resolve())
        except build.BuildError as error:
            print(f"\n*** SOAR is installed WITHOUT its native rasteriser: {error}\n", file=sys.stderr)


setup(
    ext_modules=[Extension("soar.raster.native.raster", sources=[], optional=True)],
    cmdclass={"build_ext": BuildNative},
    package_data={"soar.raster": ["native/*.cpp", "native/*.h"]},
)
