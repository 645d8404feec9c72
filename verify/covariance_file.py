"""The [covariance] of rig.toml: what calibration knows of its own parameters' uncertainty."""

import re
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from verify.errors import InputError
from verify.records import Array
from verify.rig import Covariance
from verify.toml_file import encode_numbers, fault, not_negative

# of symmetry, unit diagonal and smallest eigenvalue: six decimals in the file; more is an error
CORRELATION_TOLERANCE = 1e-6

_PARAMETER = re.compile(
    r"(left|right)\.[a-z][a-z0-9_]*"
    r"|robot_base\.([xyz]_mm|r[xyz]_deg)"
    r"|led\..+\.[xyz]_mm",
    re.DOTALL,
)


class CovarianceTable(msgspec.Struct, kw_only=True):
    """The keys of [covariance]."""

    parameters: list[str]
    standard_uncertainty: list[float]
    correlation: list[list[float]]
    degrees_of_freedom: float | None = None
    temperature_c: float | None = None


def checked(path: Path, table: CovarianceTable) -> Covariance:
    """Check a decoded [covariance].

    Raises:
        InputError: a name of no known form or twice, another size, a negative uncertainty, or a
            correlation that is none: not symmetric, a diagonal other than 1, not positive
            semidefinite.
    """
    names = table.parameters
    for index, name in enumerate(names):
        if not _PARAMETER.fullmatch(name):
            expected = "a name is like left.fx_px, robot_base.rz_deg or led.A.x_mm"
            raise fault(path, f"covariance.parameters[{index}]", f'is "{name}"', expected)
        if name in names[:index]:
            raise fault(
                path, f"covariance.parameters[{index}]", f'repeats "{name}"', "each stands once"
            )
    for index, u in enumerate(table.standard_uncertainty):
        not_negative(path, f"covariance.standard_uncertainty[{index}]", u)
    count = len(names)
    if len(table.standard_uncertainty) != count:
        found = f"has {len(table.standard_uncertainty)} numbers"
        raise fault(path, "covariance.standard_uncertainty", found, f"there are {count} parameters")
    rows = table.correlation
    if len(rows) != count or any(len(row) != count for row in rows):
        expected = f"{count} rows of {count} are expected, one a parameter"
        raise fault(path, "covariance.correlation", "has another size", expected)
    correlation = _correlation(path, np.array(rows).reshape(count, count))
    if table.degrees_of_freedom is not None and table.degrees_of_freedom <= 0:
        found = f"is {table.degrees_of_freedom}"
        raise fault(path, "covariance.degrees_of_freedom", found, "a positive number is expected")
    return Covariance(
        parameters=tuple(names),
        standard_uncertainty=np.array(table.standard_uncertainty, dtype=float),
        correlation=correlation,
        degrees_of_freedom=table.degrees_of_freedom,
        temperature_c=table.temperature_c,
    )


def _correlation(path: Path, matrix: Array) -> Array:
    def refused(found: str, expected: str) -> InputError:
        return fault(
            path, "covariance.correlation", found, expected, "Write it with more decimals."
        )

    if not len(matrix):
        return matrix
    if np.abs(matrix - matrix.T).max() > CORRELATION_TOLERANCE:
        row, column = np.unravel_index(np.abs(matrix - matrix.T).argmax(), matrix.shape)
        pair = f"{matrix[row, column]} and {matrix[column, row]}"
        found = f"has {pair} at [{row}][{column}] and [{column}][{row}]"
        raise refused(found, "a correlation is symmetric")
    if np.abs(np.diag(matrix) - 1).max() > CORRELATION_TOLERANCE:
        raise refused(
            "has a diagonal that is not 1", "each parameter's correlation with itself is 1"
        )
    least = float(np.linalg.eigvalsh(matrix)[0])
    if least < -CORRELATION_TOLERANCE:
        raise refused(f"has the eigenvalue {least:.2g}", "no variance is negative")
    symmetric: Array = (matrix + matrix.T) / 2
    return symmetric


def table(covariance: Covariance) -> dict[str, Any]:
    """Lay a covariance out as the keys of [covariance]."""
    return {
        "parameters": list(covariance.parameters),
        "standard_uncertainty": encode_numbers(covariance.standard_uncertainty),
        "correlation": encode_numbers(covariance.correlation),
        "degrees_of_freedom": covariance.degrees_of_freedom,
        "temperature_c": covariance.temperature_c,
    }
