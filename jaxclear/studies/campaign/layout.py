"""The Zarr group of a campaign: which arrays it has, and how large they are."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxclear.studies.base import SampleResult
from jaxclear.studies.campaign.plan import Plan

__all__ = [
    "CLAIMS",
    "ENDED",
    "FINISHED",
    "KIND",
    "ORDER",
    "OUTCOME",
    "RESPONSES",
    "SAMPLES",
    "UNKNOWN",
    "VALUES",
    "VERSIONS",
    "WHEN",
    "WORST",
    "made",
    "resized",
]

KIND = "a Monte Carlo campaign"
SAMPLES, CLAIMS, VERSIONS = "samples.zarr", "claims", "versions"
VALUES, RESPONSES, OUTCOME, ENDED = "values", "responses", "outcome", "ended"
WORST, WHEN, FINISHED = "check_worst", "check_time", "finished"
# In which order samples come: point by point, the scramblings taking turns.
ORDER = "scramblings by turns"
# An outcome that no sample has.
UNKNOWN = -1


def made(place: Path, plan: Plan, told: dict[str, Any], kind: SampleResult) -> None:
    """Makes the group for the samples of a plan. `told`: all that is to be known of them, as JSON;
    `kind`: what a batch of samples gives."""
    import zarr

    figures = [
        (check.name, place) for check, own in kind.checks.figures.items() for place in own.places
    ]
    group = zarr.open_group(place, mode="w")
    own = {"what": KIND, "order": ORDER, "plan": plan._asdict(), "figures": figures}
    group.attrs.put(told | own)
    columns = {VALUES: len(told["recorded"]["names"])}
    columns |= {RESPONSES: len(kind.responses), WORST: len(figures), WHEN: len(figures)}
    dims = {VALUES: "variable", RESPONSES: "response", WORST: "figure", WHEN: "figure"}
    for name, width in columns.items():
        if width:
            _array(group, name, (plan.samples, width), plan.chunk, ("sample", dims[name]))
    _array(group, ENDED, (plan.samples,), plan.chunk, ("sample",))
    _array(group, OUTCOME, (plan.samples,), plan.chunk, ("sample",), np.int8, UNKNOWN)
    _array(group, FINISHED, (plan.chunks,), 1, ("chunk",), np.int64, 0)


def resized(arrays: Mapping[str, Any], plan: Plan, alter: bool = True) -> bool:
    """Makes the arrays as long as a plan asks, if they are to be altered; whether any is not."""
    wrong = False
    for name, array in arrays.items():
        rows = plan.chunks if name == FINISHED else plan.samples
        if array.shape[0] != rows:
            wrong = True
            if alter:
                array.resize((rows, *array.shape[1:]))
    return wrong


def _array(group, name, shape, chunk, dims, kind=float, fill=np.nan):
    """An empty array in chunks along its first axis."""
    from zarr.codecs import BloscCodec

    # Digits of responses are noise to a compressor: what there is to gain, the fastest one gains.
    codec = BloscCodec(cname="lz4", clevel=1, shuffle="shuffle")
    group.create_array(
        name,
        shape=shape,
        chunks=(chunk, *shape[1:]),
        dtype=kind,
        fill_value=fill,
        dimension_names=dims,
        compressors=codec,
    )
