"""Static HTML pages: demonstration, report, failures and replays."""
