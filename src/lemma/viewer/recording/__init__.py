"""Episodes that last: what happened in them, as files that play without a server."""
