"""A study that is kept on disk chunk by chunk, and goes on where it was interrupted:
`jaxclear.campaign`, and `jaxclear.open_campaign` to read it.
"""

import inspect
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import check_count, check_flags, expect
from jaxclear.ground.wording import listed, meant
from jaxclear.studies.base import AbstractProblem, SampleResult
from jaxclear.studies.campaign.plan import Evaluation, Plan, planned
from jaxclear.studies.campaign.recorded import RecordedProblem, in_json
from jaxclear.studies.campaign.result import Campaign
from jaxclear.studies.campaign.samples import KIND, Samples
from jaxclear.studies.campaign.studies import kept_study
from jaxclear.studies.campaign.work import Heard, by_threads
from jaxclear.studies.campaign.workers import by_workers, check_client
from jaxclear.studies.sampling import check_sampled, usual_scramblings
from jaxclear.studies.store import checked_folder, refuse_other
from jaxclear.studies.texts import in_texts

__all__ = ["campaign", "open_campaign"]

# What a campaign takes beside the arguments that it names.
SAMPLED = ("sampling", "scramblings")


@answering
def campaign(
    problem: AbstractProblem,
    samples: int | None = None,
    *,
    folder: str | Path,
    study: Callable | None = None,
    seed: int | None = None,
    chunk: int | None = None,
    client: Any = None,
    progress_bar: bool = False,
    **settings: Any,
) -> Any:
    """A Monte Carlo study of any size, kept in a folder (Zarr) chunk by chunk: values, responses,
    outcomes, warnings, seed, versions and what the problem is.

    Asked again, it goes on from the chunks that are finished; a folder of another problem, or of
    other samples, is refused with what differs. Ctrl-C keeps all finished chunks; whatever ends the
    process, the chunks in work, one a thread, are all that is lost. Several processes may work at
    one folder: each chunk is claimed by one. Memory does not grow with the samples.

    `samples`, `seed`, and in `settings` also `sampling` and `scramblings`, as in `monte_carlo`,
    whose samples these are: a sample has the same values and, on one kind of machine, the same
    responses to the last bit in whatever chunks and threads it is computed. `chunk`: samples in a
    file, rounded up to whole batches; an older folder keeps its own. `client`: a
    `dask.distributed.Client`, whose workers compute and write the chunks, in a folder that all of
    them see. `progress_bar` shows rate, time left, failures.

    `study`: another one to keep, `jaxclear.sensitivity`, `sobol_indices`, `surface`, `worst_case`,
    `design`, `wear_life` or `wear_lives`, with its own arguments in `settings`; its own result is
    returned. Its samples or lives are kept as they are computed, by one process at a time.

    Raises `ValueError` with a sentence for what cannot be asked, `ImportError` without zarr.
    """
    check_flags("campaign", progress_bar=progress_bar)
    if study is not None:
        given = {"samples": samples, "seed": seed, "chunk": chunk, "client": client}
        given["progress_bar"] = progress_bar or None
        return kept_study(study, problem, folder, given, settings)
    samples, seed = 1024 if samples is None else samples, 0 if seed is None else seed
    asked = _asked(problem, samples, seed, chunk, settings)
    if client is not None:
        check_client(client)
    try:
        return _sampled(problem, asked, folder, client, progress_bar)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(_interrupted(folder)) from None


@answering
def open_campaign(folder: str | Path, problem: AbstractProblem | None = None) -> Campaign:
    """The campaign in a folder, finished or not. `problem`: that which it is of, to run single
    samples again; without it everything else can be read. Raises `ValueError` with a sentence where
    the folder holds none, or one of another problem."""
    kept = Samples.opened(folder)
    if problem is None:
        return Campaign(kept, RecordedProblem.of_json(kept.told["recorded"]))
    expect(problem, AbstractProblem, "problem of open_campaign", "a jaxclear.Problem")
    refuse_other(kept.folder, kept.told, KIND, in_texts(problem))
    return Campaign(kept, problem)


def _sampled(
    problem: AbstractProblem, asked: Plan, folder: Any, client: Any, shown: bool
) -> Campaign:
    """All samples of a plan, those computed that are not in the folder."""
    evaluation = Evaluation(problem, asked)
    kind = evaluation.compiled if client is None else evaluation.traced
    kept, left = _begun(folder, problem, asked, kind)
    evaluation.plan = kept.plan
    with _progress(shown, kept.plan, left) as heard:
        if client is None:
            by_threads(kept, evaluation, left, heard)
        else:
            by_workers(client, kept, problem, left, heard)
    kept.settle(problem.second_look)
    kept.tidy()
    return Campaign(kept, problem)


def _asked(problem: Any, samples: Any, seed: Any, chunk: Any, sampled: dict[str, Any]) -> Plan:
    """The plan of what is asked. Raises `ValueError` or `TypeError` with a sentence."""
    for name in sampled:
        if name not in SAMPLED:
            known = [*inspect.signature(campaign).parameters][:-1]
            raise TypeError(
                f'jaxclear.campaign has no argument "{name}"; it takes '
                f"{listed([*known, *SAMPLED])}.{meant(name, [*known, *SAMPLED])}"
            )
    sampling = sampled.get("sampling", "sobol")
    check_sampled(problem, samples, seed, sampling)
    parts = sampled.get("scramblings")
    parts = usual_scramblings(samples) if parts is None else parts
    check_count("scramblings of campaign", parts)
    if parts > samples:
        raise ValueError(f"{samples} samples cannot be {parts} scramblings; take fewer of these.")
    if chunk is not None:
        check_count("chunk of campaign", chunk)
    return planned(problem, samples, seed, sampling, parts, chunk)


def _begun(
    folder: Any, problem: AbstractProblem, plan: Plan, kind: Callable[[], SampleResult]
) -> tuple[Samples, list[int]]:
    """The samples in a folder, made for a `kind` of samples where there are none, and the chunks
    that are left."""
    checked_folder(folder)
    texts = in_texts(problem)
    found = Samples.known(folder)
    if found is None:
        told = {"problem": json.dumps(texts), "recorded": in_json(problem)}
        found = Samples.made(folder, plan, told, kind())
    # Another process may have been first.
    refuse_other(found.folder, found.told, KIND, texts)
    for name in ("samples", "seed", "sampling", "scramblings"):
        there, here = getattr(found.plan, name), getattr(plan, name)
        if there != here:
            raise ValueError(
                f"the folder {found.folder} holds a campaign of this problem with "
                f"{name}={there!r}, not {here!r}. Ask for the same, or give another folder."
            )
    finished = found.finished()
    if len(finished):
        found.warn_of_versions()
    return found, [int(n) for n in np.setdiff1d(np.arange(found.plan.chunks), finished)]


@contextmanager
def _progress(shown: bool, plan: Plan, left: list[int]) -> Iterator[Heard]:
    """A bar with rate, time left and failures so far; what is told of each finished chunk."""
    sizes = {number: plan.span(number)[1] - plan.span(number)[0] for number in left}
    before = plan.samples - sum(sizes.values())
    failed = [0]
    with tqdm(
        total=plan.samples, initial=before, desc="campaign", unit=" samples", disable=not shown
    ) as bar:

        def heard(number: int, failures: int) -> None:
            failed[0] += failures
            bar.set_postfix_str(f"{failed[0]} failed", refresh=False)
            bar.update(sizes[number])

        yield heard


def _interrupted(folder: Any) -> str:
    """What is said after Ctrl-C."""
    try:
        kept = Samples.opened(folder)
    except ValueError:
        return "The campaign was interrupted before its first chunk."
    done, plan = len(kept.finished()), kept.plan
    return (
        f"The campaign was interrupted. {done} of {plan.chunks} chunks (of {plan.chunk} samples) "
        f"are kept in {folder}; ask the same again, and it goes on from there."
    )
