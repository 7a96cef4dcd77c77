"""A run as one HTML page, made from nothing but the run's folder."""

from cgtorch.report.page.page import report_page as report_page
