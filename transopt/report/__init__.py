"""What a person reads of a library: tables, markdown, figures."""
