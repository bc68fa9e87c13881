"""Tables are read with the separators and the decimal sign that they show."""

import numpy as np
import pytest

from jaxclear.ground.columns import columns_of


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("a,b\n1.5,2\n3,4\n", [[1.5, 3.0], [2.0, 4.0]]),
        ("a,b\n1,2\n3,4\n", [[1.0, 3.0], [2.0, 4.0]]),
        ("a;b\n1,5;2\n3;4,25\n", [[1.5, 3.0], [2.0, 4.25]]),
        ("a;b\n1.5;2\n3;4.25\n", [[1.5, 3.0], [2.0, 4.25]]),
        ("a\tb\n1,5\t2\n3\t4\n", [[1.5, 3.0], [2.0, 4.0]]),
        ("a;b;c\n1.5;2;slow, then fast\n3;4;-\n", [[1.5, 3.0], [2.0, 4.0]]),
        ("a;b;c\n1,5;2;some\n3;4,25;01.02.2026\n", [[1.5, 3.0], [2.0, 4.25]]),
        ("a;b;c\n1,5;2;01.02.2026\n3;4;-\n", [[1.5, 3.0], [2.0, 4.0]]),
        ("a;b\n1;2\n3,5;4\n", [[1.0, 3.5], [2.0, 4.0]]),
        ("a; b\n1; 2\n3; 4.5\n", [[1.0, 3.0], [2.0, 4.5]]),
    ],
)
def test_commas_are_separators_or_decimal(text, values, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(text)
    np.testing.assert_array_equal(columns_of(path, ["a", "b"]), values)
