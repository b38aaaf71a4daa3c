"""Names that a person got nearly right."""

import difflib
from collections.abc import Iterable


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """` (did you mean X?)` with the known name nearest to `name`, or an empty text.

    Upper and lower case, hyphens and underscores count alike; the beginning of a name is near.
    """
    plain, typed = {_plain(k): k for k in known}, _plain(str(name))
    begun = [k for k in plain if len(typed) >= 3 and k.startswith(typed)]
    nearest = begun or difflib.get_close_matches(typed, plain, n=1, cutoff=0.6)
    return f" (did you mean {plain[nearest[0]]}?)" if nearest else ""


def _plain(name: str) -> str:
    return name.casefold().replace("_", "-").replace(" ", "")
