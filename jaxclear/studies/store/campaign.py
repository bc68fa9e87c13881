"""A study that is kept on disk chunk by chunk, and goes on where it was interrupted:
`jaxclear.campaign`, of Monte Carlo or of another study, and `jaxclear.open_campaign` to read it.
"""

import inspect
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_flags, expect
from jaxclear.ground.wording import described, listed, meant
from jaxclear.studies.campaign.recorded import of_json
from jaxclear.studies.design.design import design
from jaxclear.studies.life.wear_life import wear_life, wear_lives
from jaxclear.studies.problem import Problem
from jaxclear.studies.reliability.reliability import reliability
from jaxclear.studies.sampling import check_sampled, checked_scramblings
from jaxclear.studies.sensitivity.sensitivity import sensitivity
from jaxclear.studies.sequential import FIRST_SAMPLES, first_of
from jaxclear.studies.statistics.accuracy import asked_of
from jaxclear.studies.statistics.shapley import shapley_effects
from jaxclear.studies.statistics.sobol_indices import sobol_indices
from jaxclear.studies.store.digest import in_texts
from jaxclear.studies.store.files import checked_folder
from jaxclear.studies.store.result import Campaign
from jaxclear.studies.store.run import Wanted, computed
from jaxclear.studies.store.samples import KIND, Samples, planned
from jaxclear.studies.store.store import Ledger, current, refuse_other
from jaxclear.studies.store.threads import AbstractWork, Threads
from jaxclear.studies.store.workers import Workers, check_client
from jaxclear.studies.surface.surface import surface
from jaxclear.studies.worst_case import worst_case

# What studies keep, in words. Some keep records of their own; of others all samples are kept.
OWN_RECORDS = {wear_life: "a wear life", wear_lives: "wear lives", design: "a design"}
BY_SAMPLES = {
    sensitivity: "a sensitivity study",
    sobol_indices: "a study of Sobol' indices",
    surface: "a response surface",
    worst_case: "a worst case",
    reliability: "a reliability",
    shapley_effects: "a study of Shapley effects",
}
# What keeps lives, in words.
OTHERWISE = (
    "is no compiled program, and a campaign keeps samples of one; ask jaxclear.monte_carlo for "
    "lives as responses, or jaxclear.wear_lives(..., store=folder) for lives that are kept."
)
# How studies call the number of their samples.
COUNTS = ("samples", "sample")
# What a campaign takes beside the arguments that it names.
SAMPLED = ("sampling", "scramblings", "accuracy", "chunk")


@answering
def campaign(
    problem: Problem,
    samples: int | None = None,
    *,
    folder: str | Path,
    study: Callable | None = None,
    seed: int | None = None,
    client: Any = None,
    verify: bool = True,
    progress_bar: bool = False,
    **settings: Any,
) -> Any:
    """A Monte Carlo study of any size, kept in a folder chunk by chunk: values, responses,
    outcomes, warnings, seed, versions and what the problem is, as text and NumPy's archives.

    Asked again, it goes on from the chunks that are finished, also to more samples: it becomes what
    it would be had it been asked for them at once, in the scramblings that the folder has.
    Samples in a last chunk that was not full are computed again, and count as unfinished until
    then; so are chunks that are missing or damaged, and a warning says so. A folder of another
    problem, or of other samples, is refused with what differs. Ctrl-C
    keeps all finished chunks; whatever ends the process, the chunks in work, one a thread, are all
    that is lost. Several processes may work at one folder: each chunk is claimed by one. Memory
    does not grow with the samples.

    `samples`, `seed`, and in `settings` also `sampling`, `scramblings` and `accuracy`, as in
    `monte_carlo`, whose samples these are: a sample has the same values and, on one kind of
    machine, the same responses to the last bit in whatever chunks and threads it is computed; and
    `chunk`, samples in a file, rounded up to whole batches (an older folder keeps its own).
    `client`: a `dask.distributed.Client`, whose workers compute and write the chunks, in a folder
    that all of them see. `verify`: the first 16 samples have replicas, as in `monte_carlo`, kept as
    well. `progress_bar` shows rate, time left, failures.

    `study`: another one to keep, `jaxclear.sensitivity`, `sobol_indices`, `shapley_effects`,
    `surface`, `worst_case`, `reliability`, `design`, `wear_life` or `wear_lives`, with its own
    arguments in `settings`; its own result is returned. Its samples or lives are kept as they are
    computed, by one process at a time.

    Raises `ValueError` with a sentence for what cannot be asked, `ImportError` without zarr.
    """
    check_flags("campaign", verify=verify, progress_bar=progress_bar)
    if study is not None:
        given = {"samples": samples, "seed": seed, "client": client}
        given |= {"verify": None if verify else False}
        given |= {"chunk": settings.pop("chunk", None), "progress_bar": progress_bar or None}
        return _kept_study(study, problem, folder, given, settings)
    samples, seed = 1024 if samples is None else samples, 0 if seed is None else seed
    asked = _asked(problem, samples, seed, settings)._replace(verify=verify)
    checked_folder(folder)
    try:
        with _by(problem, client) as work:
            return computed(work, asked, folder, progress_bar)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(_interrupted(folder)) from None


@answering
def open_campaign(folder: str | Path, problem: Problem | None = None) -> Campaign:
    """The campaign in a folder, finished or not. `problem`: that which it is of, to run single
    samples again; without it everything else can be read. Raises `ValueError` with a sentence where
    the folder holds none, or one of another problem."""
    kept = Samples.opened(folder)
    if problem is None:
        return Campaign(kept, of_json(kept.told["recorded"]))
    expect(problem, Problem, "problem of open_campaign", "a jaxclear.Problem")
    refuse_other(kept.folder, kept.told, KIND, in_texts(problem))
    return Campaign(kept, problem)


def _kept_study(
    study: Any,
    problem: Problem,
    folder: Any,
    given: dict[str, Any],
    settings: dict[str, Any],
) -> Any:
    """What a study answers, from a folder as far as it is there. `given`: arguments of the campaign
    that the study may have, absent where None. Raises `ValueError` with a sentence for a study that
    is not kept, or an argument that it has not."""
    if not callable(study) or study not in OWN_RECORDS | BY_SAMPLES:
        known = [f"jaxclear.{own.__name__}" for own in OWN_RECORDS | BY_SAMPLES]
        raise ValueError(
            f"study of campaign is {described(study)}; it must be one of {listed(known)}, or left "
            "out for a Monte Carlo study."
        )
    settings = settings | _named(study, {n: own for n, own in given.items() if own is not None})
    if study in BY_SAMPLES:
        _refuse_uncompiled(problem)
    path: Path = checked_folder(folder)
    try:
        if study in OWN_RECORDS:
            return study(problem, store=path, **settings)
        expect(problem, Problem, "problem of campaign", "a jaxclear.Problem")
        with current(Ledger.opened(path, BY_SAMPLES[study], in_texts(problem))):
            return study(problem, **settings)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"The study was interrupted. What it had computed is kept in {path}; ask the same "
            "again, and it goes on from there."
        ) from None


def _refuse_uncompiled(problem: Any) -> None:
    """Raises `ValueError` with a sentence for a problem whose samples are no compiled program. What
    is no problem at all is for its study to refuse."""
    if isinstance(problem, Problem) and not problem.cost().compiled:
        raise ValueError(f"problem of campaign ({type(problem.experiment).__name__}) {OTHERWISE}")


def _named(study: Callable, given: dict[str, Any]) -> dict[str, Any]:
    """What is given, by the names that the study has for it."""
    takes = inspect.signature(study).parameters
    found = {}
    for name, value in given.items():
        known = [own for own in (COUNTS if name == "samples" else (name,)) if own in takes]
        if not known:
            raise ValueError(
                f"jaxclear.{study.__name__} has no {name}; leave it out of the campaign."
            )
        found[known[0]] = value
    return found


@contextmanager
def _by(problem: Problem, client: Any) -> Iterator[AbstractWork]:
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


def _asked(problem: Any, samples: Any, seed: Any, sampled: dict[str, Any]) -> Wanted:
    """What is asked, with its plan. Raises `ValueError` or `TypeError` with a sentence."""
    for name in sampled:
        if name not in SAMPLED:
            known = [*inspect.signature(campaign).parameters][:-1]
            raise TypeError(
                f'jaxclear.campaign has no argument "{name}"; it takes '
                f"{listed([*known, *SAMPLED])}.{meant(name, [*known, *SAMPLED])}"
            )
    sampling = sampled.get("sampling", "sobol")
    check_sampled(problem, samples, seed, sampling)
    _refuse_uncompiled(problem)
    accuracy = asked_of(sampled.get("accuracy"), problem.response_names, "campaign")
    first = samples if accuracy is None else min(samples, FIRST_SAMPLES)
    parts = checked_scramblings("campaign", first, sampled.get("scramblings"))
    first = first if accuracy is None else first_of(first, parts)
    chunk = sampled.get("chunk")
    if chunk is not None:
        check_count("chunk of campaign", chunk)
    drawn = first, seed, sampling, parts
    scrambled = sampled.get("scramblings") is not None
    return Wanted(planned(problem, drawn, chunk, samples), samples, accuracy, scrambled)


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
