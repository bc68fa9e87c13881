"""How deep a reader of a traceback is below `simulate` where a step asks a contact law."""

from benchmarks.claims import house


def test_from_simulate_to_the_law_in_a_step_are_few_functions_of_the_package():
    """Counted where the law is reached while a step of a slider-crank is traced; native's are
    among them."""
    frames = house.frames_to_a_law()
    assert frames[0].endswith("simulate.py:simulate")
    assert len(frames) <= 18, frames
