"""The type checker of the tests: a whole number is as good as a ``float``, as PEP 484 says and users write."""

from __future__ import annotations

from beartype import BeartypeConf, beartype

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
