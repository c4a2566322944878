"""From the state of the atmosphere to the terms of equation 3.7."""

from hyperval.atmosphere.engine import ENGINES, atmospheric_terms
from hyperval.atmosphere.modtran import read_chn
from hyperval.atmosphere.state import AerosolMix, AtmosphericState
from hyperval.atmosphere.terms import AtmosphericTerms

__all__ = ["ENGINES", "AerosolMix", "AtmosphericState", "AtmosphericTerms", "atmospheric_terms", "read_chn"]
