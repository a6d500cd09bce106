"""Every sample keeps every contract that its components allow; `make test` takes a few of each row of the table."""

from __future__ import annotations

from functools import cache

import pytest
from conftest import require_tool

from nmpc_codegen import OCP
from verification.contracts.contract import (
    CONTRACTS,
    HELD,
    Contract,
    components,
    in_make_test,
    reason,
    table,
    under,
)
from verification.contracts.subject import Subject
from verification.timed import Sample


@cache
def subject_of(sample: Sample) -> Subject:
    """One for all contracts of a sample."""
    return Subject(sample)


def _cells() -> list[object]:
    taken = {contract: set(in_make_test(contract)) for contract in CONTRACTS}
    return [
        pytest.param(
            sample,
            contract,
            marks=[pytest.mark.slow] * (sample not in taken[contract]),
            id=f"{sample.name}-{contract.name}",
        )
        for sample in HELD
        for contract in CONTRACTS
        if sample in under(contract)
    ]


@pytest.mark.parametrize(("sample", "contract"), _cells())
def test_a_sample_keeps_a_contract(sample: Sample, contract: Contract) -> None:
    for tool in contract.tools:
        require_tool(tool)
    contract.hold(subject_of(sample))


def test_no_cell_of_the_table_is_empty_without_a_reason() -> None:
    _, lines, reasons = table()
    assert all(all(line) for line in lines)
    assert "no sample" not in reasons
    assert reason(CONTRACTS[0], ("qp", "a new one")) == "no sample"


def test_a_broken_promise_is_seen() -> None:
    """A package that is none of its problem: solve() of another one than IPOPT's."""
    sample = next(sample for sample in HELD if sample.name == "controls dense")
    subject = Subject(sample)

    def other() -> OCP:
        ocp = sample.make()
        ocp.stage_cost(ocp.x[0])
        return ocp

    vars(subject)["oracle"] = Subject(Sample("other", other, sample.options)).oracle
    with pytest.raises(AssertionError, match=r"cost .*, that of IPOPT"):
        next(c for c in CONTRACTS if c.name == "solve equals ipopt").hold(subject)


def test_the_file_of_components_has_every_sample() -> None:
    """test_samples.py compares the entries with what is lowered."""
    assert list(components()) == [sample.name for sample in HELD]
