"""Bezier files read back: the same solid, the same fields, the same boundary."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from iga.assembly import integral, volume
from iga.conforming import straight_domain
from iga.domain import Domain, Space
from iga.errors import FormatError
from iga.exchange.export import write_vtu
from iga.exchange.reading import read_vtu
from iga.field import Field
from tests.meshes import bend, mixed_complex


@pytest.mark.parametrize("rational", [False, True], ids=["polynomial", "rational"])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_round_trip(tmp_path: Path, degree: int, rational: bool) -> None:
    flat = straight_domain(*mixed_complex(), degree)
    weights = np.random.default_rng(41).uniform(0.95, 1.05, flat.space.n) if rational else None
    domain = Domain(Space(flat.space.blocks, flat.space.n, weights), bend(0.3 * flat.points), flat.boundaries)
    field = domain.points @ np.array([1.0, 2.0, 3.0])
    write_vtu(tmp_path / "a.vtu", domain, {"T": field})
    again, fields = read_vtu(tmp_path / "a.vtu")
    assert list(fields) == ["T"]
    # Rational integrands differ between the rules on a pyramid and on its hexahedron until both have converged.
    assert abs(volume(again, 11) - volume(domain, 11)) < 1e-13
    for boundary in (None, "boundary"):
        ours = integral(domain, Field(domain.space, field), 11, boundary)
        theirs = integral(again, Field(again.space, fields["T"]), 11, boundary)
        assert abs(ours - theirs) < 1e-12


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="does not exist"):
        read_vtu(tmp_path / "none.vtu")
    (tmp_path / "text.vtu").write_text("solid nothing")
    with pytest.raises(FormatError, match=r"text\.vtu"):
        read_vtu(tmp_path / "text.vtu")
