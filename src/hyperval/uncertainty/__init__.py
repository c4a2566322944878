"""What a comparison could have found: standard errors planted in the model."""
