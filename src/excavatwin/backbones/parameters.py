"""What the parameters of a stage mean: the docstring under each field, as `excavatwin config` prints it."""

from __future__ import annotations

import ast
import inspect
import itertools
import textwrap


def meanings_of(stage: type) -> dict[str, str]:
    """Field name -> the docstring under it, of this class alone (not of its bases).

    Raises:
        OSError, TypeError, SyntaxError: the source of the class cannot be read.
    """
    found: dict[str, str] = {}
    body = ast.parse(textwrap.dedent(inspect.getsource(stage))).body[0]
    for field, text in itertools.pairwise(getattr(body, "body", [])):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(text, ast.Expr):
            constant = text.value
            if isinstance(constant, ast.Constant) and isinstance(constant.value, str):
                found[field.target.id] = " ".join(constant.value.split())
    return found
