"""One rule for each measure, used by the method and by the evaluation."""
