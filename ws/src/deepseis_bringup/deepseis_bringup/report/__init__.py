"""What a recorded run shows: columns, measures, figures, the page."""
