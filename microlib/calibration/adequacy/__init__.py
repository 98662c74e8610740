"""Whether the model of a calibration is adequate: lack of fit and cross-validation."""
