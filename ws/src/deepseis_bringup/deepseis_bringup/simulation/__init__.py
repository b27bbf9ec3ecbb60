"""Input bags of the test bench, with the page that shows them."""
