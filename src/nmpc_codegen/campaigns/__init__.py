"""Campaigns run thousands of closed loops before the first real one, and choose options and weights by their results.

from nmpc_codegen.campaigns import Box, Normal, campaign
result = campaign(ocp, flights=1000)
print(result)                 # how many are lost, with what confidence, and why
log = result.replay(result.worst(1)[0])
"""

from nmpc_codegen.campaigns.coach.choice import Choice
from nmpc_codegen.campaigns.coach.weights import Tuned, tune_weights
from nmpc_codegen.campaigns.entry import campaign
from nmpc_codegen.campaigns.judging.result import Campaign
from nmpc_codegen.campaigns.judging.verdict import Reason
from nmpc_codegen.campaigns.stated.distributions import Box
from nmpc_codegen.campaigns.stated.flight_statement import Stated
from nmpc_codegen.runtime.batch.random import Normal, Uniform
from nmpc_codegen.runtime.loops.flown import Flown

__all__ = [
    "Box",
    "Campaign",
    "Choice",
    "Flown",
    "Normal",
    "Reason",
    "Stated",
    "Tuned",
    "Uniform",
    "campaign",
    "tune_weights",
]
