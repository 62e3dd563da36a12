"""From stored results to artefacts: tables, figures, pages."""
