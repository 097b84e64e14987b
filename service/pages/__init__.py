"""The pages of the service: static HTML, styles and modules, served as they lie here."""
