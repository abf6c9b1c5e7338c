"""Evaluate detections: matching, metrics, intervals, and the report."""
