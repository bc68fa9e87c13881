"""Which joints of a scene have clearance: a word for several of them, or their names."""

from collections.abc import Mapping, Sequence

from jaxclear.ground.arguments import check_name, expect


def slack_joints(
    scene: str,
    kind: str | Sequence[str],
    kinds: Mapping[str, tuple[str, ...]],
    joints: Sequence[str],
) -> Sequence[str]:
    """The joints of a scene that have clearance.

    Args:
        scene: name of the scene in messages.
        kind: one of the words of `kinds`, or names of joints.
        kinds: joints by word.
        joints: names that exist.

    Raises:
        ValueError: the word or a name is unknown.
    """
    if isinstance(kind, str):
        check_name("kind", kind, kinds, f" of {scene} (beside a list of joints)")
    slack = kinds[kind] if isinstance(kind, str) else kind
    words = ", ".join(f'"{word}"' for word in kinds)
    expect(slack, (tuple, list), f"kind of {scene}", f"{words}, or a list of joints")
    for name in slack:
        check_name("joint", name, joints, f" in kind of {scene}")
    return slack
