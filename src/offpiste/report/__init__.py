"""Output of commands for people: tables of text, figures, and self-contained HTML pages."""
