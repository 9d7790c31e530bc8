"""Connected components of cells, and names in files of XML."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from hpcinv.mesh.io.vtu_writer import attribute
from hpcinv.mesh.topology import connected


@pytest.mark.parametrize("seed", range(5))
def test_chains_of_cells_are_found_in_any_numbering(seed: int) -> None:
    """Chains of 1, 2, 4, ... 512 bars; components are numbered by their lowest nodes."""
    random = np.random.default_rng(seed)
    lengths = 2 ** np.arange(10)
    nodes = int((lengths + 1).sum())
    names = random.permutation(nodes)
    ends = np.cumsum(lengths + 1)
    chains = [np.arange(end - length - 1, end) for end, length in zip(ends, lengths, strict=True)]
    cells = np.concatenate([np.stack([chain[:-1], chain[1:]], axis=1) for chain in chains])
    chain_of_cell = np.repeat(np.arange(10), lengths)
    order = random.permutation(len(cells))
    lowest = np.array([names[chain].min() for chain in chains])
    expected = np.argsort(np.argsort(lowest))[chain_of_cell]
    assert np.array_equal(connected(names[cells][order], nodes), expected[order])


def test_no_cells_have_no_components() -> None:
    assert connected(np.zeros((0, 4), dtype=np.int64), 0).size == 0


def test_names_are_read_back_from_xml_as_they_were_written() -> None:
    name = """<a> & "b" 'c'\tµ\nd"""
    assert ET.fromstring(f"<a name={attribute(name)}/>").get("name") == name
