"""The flights of a campaign are stated by distributions, defaults and data of every flight."""
