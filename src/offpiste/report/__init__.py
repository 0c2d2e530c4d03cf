"""What commands write for people: tables of text, figures, and HTML pages that need no other file."""
