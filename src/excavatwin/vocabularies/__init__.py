"""Named vocabularies: the classes of a segmenter by id, and the task class that each one votes for.

The shipped ones are readable TOML files in ``class_mappings/``; a user's own file has the same form. Which task class a
class belongs to is a choice that scores depend on, so each choice is a named policy.
"""

from excavatwin.vocabularies.mapping_files import digest, policies_of, read_vocabulary, shipped_vocabularies
from excavatwin.vocabularies.resolving import Resolved, fitting, parse_remap, resolve
from excavatwin.vocabularies.vocabulary import NOTHING, Vocabulary, canonical, whole

__all__ = [
    "NOTHING",
    "Resolved",
    "Vocabulary",
    "canonical",
    "digest",
    "fitting",
    "parse_remap",
    "policies_of",
    "read_vocabulary",
    "resolve",
    "shipped_vocabularies",
    "whole",
]
