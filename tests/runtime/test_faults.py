"""The text of every fault names the thing, the place and the remedy, and gives no advice that does not fit."""

from __future__ import annotations

import pytest

from tests.runtime.faults import FAULTS, Fault


def test_the_table_is_long() -> None:
    assert len(FAULTS) >= 40
    assert len({f.name for f in FAULTS}) == len(FAULTS)


@pytest.mark.few(24)
@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("fault", FAULTS, ids=lambda f: f.name)
def test_fault(fault: Fault) -> None:
    text = fault.commit()
    assert [words for words in fault.says if words not in text] == [], text
    assert [words for words in fault.never if words in text] == [], text
