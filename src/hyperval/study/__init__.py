"""Trade-off studies: many evaluations of the model over grids, lists and random designs."""
