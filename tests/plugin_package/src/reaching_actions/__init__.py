"""Actions for cgtorch, found by their entry points once the package is installed."""
