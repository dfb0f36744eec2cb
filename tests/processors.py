"""A processor with narrower vectors, played by the switches of numpy, OpenBLAS, OpenCV and the C library."""

import os
import subprocess
import sys

import pytest

LESSER = {
    "OPENBLAS_CORETYPE": "Prescott",
    "OPENCV_IPP": "disabled",
    "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,FMA3,AVX,FP16,SSE4.2,SSE4.1",
    "OPENCV_LOG_LEVEL": "SILENT",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX2,-FMA,-FMA4",
}

on_linux = pytest.mark.skipif(sys.platform != "linux", reason="the switches of OpenBLAS are those of Linux on x86")


def on_a_lesser_processor(module: str, call: str) -> str:
    """What a call of a function of a module prints there."""
    try:
        from numpy._core._multiarray_umath import __cpu_dispatch__ as optional
    except ImportError:  # numpy 1
        from numpy.core._multiarray_umath import __cpu_dispatch__ as optional
    variables = {"NPY_DISABLE_CPU_FEATURES": " ".join(optional), "PYTHONPATH": os.pathsep.join(sys.path)}
    answer = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", f"import {module} as module; print(module.{call})"],
        env={**os.environ, **LESSER, **variables},
        capture_output=True,
        check=True,
        text=True,
    )
    return answer.stdout.strip()
