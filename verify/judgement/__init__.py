"""What a comparison means: mean errors, visibility, resolved errors, verdict and diagnosis."""
