"""A scenery with posed vehicles, which answers all queries of rays."""
