"""A run as one HTML page, made from the run's folder alone."""

from cgtorch.report.page.page import report_page as report_page
