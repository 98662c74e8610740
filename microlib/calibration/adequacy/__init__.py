"""Whether the model of a calibration is adequate: lens terms, lack of fit, cross-validation."""
