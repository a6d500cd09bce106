"""Flights get verdicts, a campaign gets a result, and both can be compared with loops with converged plans."""
