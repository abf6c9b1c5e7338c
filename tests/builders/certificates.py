"""Certificates by openssl for clusters with TLS."""

import shutil
import subprocess

import pytest

needs_openssl = pytest.mark.xfail(shutil.which("openssl") is None, reason="there is no openssl to make certificates", run=False)


def certificates(folder):
    """An authority's certificate, a signed one, and its key, as `Scheduler.tls` and as options of Dask."""
    new = ["-nodes", "-newkey", "rsa:2048", "-days", "2"]

    def openssl(*words):
        subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)

    openssl("req", "-x509", *new, "-subj", "/CN=authority", "-keyout", "ca-key.pem", "-out", "ca.pem")
    openssl("req", *new, "-subj", "/CN=node", "-keyout", "key.pem", "-out", "request.pem")
    signed_by = ["-CA", "ca.pem", "-CAkey", "ca-key.pem", "-CAcreateserial"]
    openssl("x509", "-req", "-in", "request.pem", *signed_by, "-days", "2", "-out", "cert.pem")
    ca, cert, key = (folder / name for name in ("ca.pem", "cert.pem", "key.pem"))
    options = ["--protocol", "tls", "--tls-ca-file", str(ca), "--tls-cert", str(cert), "--tls-key", str(key)]
    return {"tls_ca_file": str(ca), "tls_client_cert": str(cert), "tls_client_key": str(key)}, options
