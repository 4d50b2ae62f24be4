"""The live page: `gelform live`; a server on this machine and a page in the browser (extra `live`)."""
