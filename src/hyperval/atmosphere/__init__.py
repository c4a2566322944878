"""From the state of the atmosphere to the terms of equation 3.7."""
