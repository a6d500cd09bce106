"""Why a call was not OK: what is not finite, what is violated, what to try."""
