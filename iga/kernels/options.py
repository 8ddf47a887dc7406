"""Compiler options shared by all kernels."""

from __future__ import annotations

from typing import Any

OPTIONS: dict[str, Any] = {
    "nogil": True,
    "cache": True,
    "error_model": "numpy",
    # Contraction to fused multiply-add and reordering of sums; infinities and NaN keep their meaning.
    "fastmath": {"contract", "reassoc", "nsz"},
}
#: The same without any licence: sums as they are written, infinities and NaN as IEEE has them.
PLAIN: dict[str, Any] = {**OPTIONS, "fastmath": False}
