"""The forecasting experiment: data sets composed, a small forecaster, its forecasts compared."""
