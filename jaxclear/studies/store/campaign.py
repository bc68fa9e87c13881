"""A study that is kept on disk chunk by chunk, and goes on where it was interrupted:
`jaxclear.campaign`, and `jaxclear.open_campaign` to read it.

A folder is begun or found, made larger where more samples are asked for, what it lacks is computed,
and its first samples get replicas.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_flags, expect
from jaxclear.ground.warning import warn
from jaxclear.integrators.checks import Checks
from jaxclear.studies.problem import Problem
from jaxclear.studies.replicas import MOST_REPLICAS
from jaxclear.studies.sampling import check_sampled, checked_scramblings, groups
from jaxclear.studies.sequential import FIRST_SAMPLES, first_of, until_accurate
from jaxclear.studies.statistics.accuracy import Piece, parse_accuracy
from jaxclear.studies.store.batch import RESPONSES, VALUES
from jaxclear.studies.store.digest import in_texts
from jaxclear.studies.store.recorded_problem import in_json, of_json
from jaxclear.studies.store.result import Campaign
from jaxclear.studies.store.samples import KIND, Plan, Samples, batch_of, planned
from jaxclear.studies.store.store import check_folder
from jaxclear.studies.store.workers import AbstractWork, Heard, Threads, Workers, check_client

# What keeps lives, in words.
OTHERWISE = (
    "is no compiled program, and a campaign keeps samples of one; ask jaxclear.monte_carlo(..., "
    "store=folder) for lives as responses, or jaxclear.wear_life_sample(..., store=folder)."
)
# Samples that are read together, about.
READ = 1 << 16
# Claimed by the process that adds replicas.
VERIFYING = "replicas"


@answering
def campaign(
    problem: Problem,
    samples: int = 1024,
    *,
    folder: str | Path,
    seed: int = 0,
    sampling: str = "sobol",
    scramblings: int | None = None,
    accuracy: float | Mapping[str, float] | None = None,
    chunk: int | None = None,
    client: Any = None,
    verify: bool = True,
    progress_bar: bool = False,
) -> Campaign:
    """A Monte Carlo study of any size, stored in a folder chunk by chunk.

    The folder holds values, responses, outcomes, warnings, seed, versions and the problem, in plain
    files with checksums. A repeated call continues with the chunks that are missing or damaged,
    also to more samples; it gives the same result as one call would have. Ctrl-C keeps all finished
    chunks. Several processes may work on one folder. The memory does not grow with the samples.

    Args:
        problem: the problem.
        samples: number of samples; 1024 by default.
        folder: path of the folder. One of another problem or other samples is refused with the
            difference.
        seed: seed of the random numbers; 0 by default.
        sampling: name of the method, "sobol" (default) or "random", as of `monte_carlo`.
        scramblings: number of independent subsets of the sample, as of `monte_carlo`; None
            (default) for its.
        accuracy: required half width of the 95 % interval of each mean, a factor [1] or a
            dictionary, as of `monte_carlo`; None (default) for none.
        chunk: number of samples in a file; None (default) for what fits the memory.
        client: a `dask.distributed.Client` whose workers compute the chunks; None (default) for
            this process.
        verify: whether to repeat the first 16 samples with finer steps, as of `monte_carlo`; True
            by default.
        progress_bar: whether to show rate, remaining time and failures; False by default.

    Returns:
        The `Campaign`.

    Raises:
        ValueError: if an argument is wrong.
    """
    check_flags("campaign", verify=verify, progress_bar=progress_bar)
    check_sampled(problem, samples, seed, sampling)
    if not problem.cost().compiled:
        raise ValueError(f"problem of campaign ({type(problem.experiment).__name__}) {OTHERWISE}")
    if chunk is not None:
        check_count("chunk of campaign", chunk)
    goals = parse_accuracy(accuracy, problem.response_names, "campaign")
    first = samples if goals is None else min(samples, FIRST_SAMPLES)
    parts = checked_scramblings("campaign", first, scramblings)
    first = first if goals is None else first_of(first, parts)
    plan = planned(problem, (first, seed, sampling, parts), chunk, samples)
    checked = ("seed", "sampling", "scramblings")[: 2 + (scramblings is not None)]
    check_folder(folder)
    try:
        with _make_workers(problem, client) as work:
            stored = _open_samples(problem, plan, checked, samples, folder)
            # The plan first: whatever ends the process from here on, the folder knows what was
            # asked of it.
            if goals is None:
                stored = _enlarge_plan(stored, samples, samples, problem)
            if len(stored.finished()):
                stored.warn_of_versions()
            run, short = _Run(work, stored, samples, progress_bar), ""
            if goals is None:
                run.grow(samples)
            else:
                first = max(plan.samples, stored.plan.samples)
                short = until_accurate(problem, first, samples, goals, run.grown)
            if verify:
                _add_replicas(run.stored, work)
            run.stored.conclude()
            return Campaign(run.stored, problem, short)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(_interrupted_sentence(folder)) from None


@answering
def open_campaign(folder: str | Path, problem: Problem | None = None) -> Campaign:
    """Open the campaign in a folder, finished or not.

    Args:
        folder: path of the folder.
        problem: its problem, to run single samples again; None (default) to read everything else.

    Returns:
        The `Campaign`.

    Raises:
        ValueError: if the folder holds none, or one of another problem.
    """
    stored = Samples.open(folder)
    if problem is None:
        return Campaign(stored, of_json(stored.description["recorded"]))
    expect(problem, Problem, "problem of open_campaign", "a jaxclear.Problem")
    stored.store.refuse_other(stored.description, KIND, in_texts(problem))
    return Campaign(stored, problem)


@contextmanager
def _make_workers(problem: Problem, client: Any) -> Iterator[AbstractWork]:
    """Who computes: the threads here, or the workers of a client."""
    if client is None:
        yield Threads(problem)
        return
    check_client(client)
    workers = Workers(problem, client)
    try:
        yield workers
    finally:
        workers.close()


def _open_samples(
    problem: Problem, plan: Plan, checked: tuple[str, ...], most: int, folder: Any
) -> Samples:
    """The samples in a folder, which is told of them where there are none. `checked`: what of a
    plan must be as in the folder."""
    created = Samples.create(folder, plan, in_texts(problem), in_json(problem))
    for name in checked:
        there, here = getattr(created.plan, name), getattr(plan, name)
        if there != here:
            raise ValueError(
                f"the folder {created.folder} holds a campaign of this problem with "
                f"{name}={there!r}, not {here!r}. Ask for the same, or give another folder."
            )
    if created.plan.samples > most:
        raise ValueError(
            f"the folder {created.folder} holds a campaign of this problem with "
            f"samples={created.plan.samples}, more than {most}. Ask for as many or more, or "
            "give another folder."
        )
    return created


def _enlarge_plan(stored: Samples, samples: int, most: int, problem: Problem) -> Samples:
    """The same with room for so many samples; for more, up to the `most`, where other processes
    have planned these."""
    if stored.plan.samples >= samples:
        return stored
    return stored.extend(samples, batch_of(problem, samples)).view(most)


class _Run:
    """Grows what is in a folder, to the `most` samples that are asked for; other processes may
    make it larger."""

    def __init__(self, by: AbstractWork, stored: Samples, most: int, show_bar: bool):
        self.by, self.stored, self.most, self.show_bar = by, stored, most, show_bar

    def grow(self, samples: int) -> None:
        """Has so many samples in the folder, and computes those that it lacks."""
        self.stored = _enlarge_plan(self.stored, samples, self.most, self.by.problem)
        plan = self.stored.plan
        remaining = np.setdiff1d(np.arange(plan.chunks), self.stored.finished()).tolist()
        if missing := self.stored.describe_missing(remaining):
            warn(missing)
        if remaining:
            with _make_progress(self.show_bar, plan, remaining) as heard:
                self.by.compute(self.stored, remaining, heard)

    def grown(self, samples: int) -> Iterator[Piece]:
        """Has so many samples in the folder, and reads all that are then there in pieces of some
        chunks: responses (samples,), and their scramblings."""
        self.grow(samples)
        names, plan = self.by.problem.response_names, self.stored.plan
        size = max(READ // plan.chunk, 1) * plan.chunk
        for first in range(0, plan.samples, size):
            at = slice(first, min(first + size, plan.samples))
            rows = self.stored.read(at, RESPONSES)[RESPONSES]
            group = groups(at.stop, plan.scramblings, at.start)
            yield {name: rows[:, i] for i, name in enumerate(names)}, group


def _add_replicas(samples: Samples, by: AbstractWork) -> None:
    """Adds the replicas that the finished samples in a folder lack, if their problem has any:
    finer runs of the first ones, written once all samples are there. A campaign that becomes larger
    keeps them, and adds what it lacks."""
    count = min(MOST_REPLICAS, samples.plan.samples)

    def load() -> Any:
        finer = samples.finer()
        return finer if finer is not None and len(finer.outcome) >= count else None

    def compute() -> Any:
        finer = samples.finer()
        values = samples.read(slice(0, count), VALUES)[VALUES]
        remaining = values[0 if finer is None else len(finer.outcome) :]
        result: Any = by.replicated(samples.plan, remaining)
        result = dataclasses.replace(result, checks=Checks())
        parts = [part for part in (finer, result) if part is not None]
        samples.keep_finer(values, jax.tree.map(lambda *part: np.concatenate(part), *parts))

    if by.problem.refine() is not None:
        samples.store.obtain(VERIFYING, load, compute, wait=True)


@contextmanager
def _make_progress(show_bar: bool, plan: Plan, remaining: list[int]) -> Iterator[Heard]:
    """A bar with rate, time left and failures so far; what is told of each finished chunk."""
    sizes = {number: plan.span(number)[1] - plan.span(number)[0] for number in remaining}
    before = plan.samples - sum(sizes.values())
    failed = [0]
    with tqdm(
        total=plan.samples, initial=before, desc="campaign", unit=" samples", disable=not show_bar
    ) as bar:

        def heard(number: int, failures: int) -> None:
            failed[0] += failures
            bar.set_postfix_str(f"{failed[0]} failed", refresh=False)
            bar.update(sizes[number])

        yield heard


def _interrupted_sentence(folder: Any) -> str:
    """What is said after Ctrl-C."""
    try:
        stored = Samples.open(folder)
    except ValueError:
        return "The campaign was interrupted before its first chunk."
    done, plan = len(stored.finished()), stored.plan
    return (
        f"The campaign was interrupted. {done} of {plan.chunks} chunks (of {plan.chunk} samples) "
        f"are kept in {folder}; ask the same again, and it goes on from there."
    )
