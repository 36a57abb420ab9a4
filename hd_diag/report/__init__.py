"""A bag or a verdict on one HTML page: its numbers (`facts`), its pictures, the page."""
