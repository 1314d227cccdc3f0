#!/bin/sh
# Makes the certificates of judge/tests/https.rs again, valid from 2020 to 2120: an
# authority, and a server's certificate for 127.0.0.1 that it signs. The server's key
# protects nothing but that test.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
made=$(mktemp -d)
trap 'rm -rf "$made"' EXIT
cd "$made"
cat >ca.conf <<'END'
[ca]
default_ca = test
[test]
new_certs_dir = .
database = issued
rand_serial = yes
default_md = sha256
policy = names
default_startdate = 20200101000000Z
default_enddate = 21200101000000Z
[names]
commonName = supplied
[authority]
basicConstraints = critical, CA:TRUE
[server]
basicConstraints = critical, CA:FALSE
subjectAltName = IP:127.0.0.1
END
: >issued
for name in authority server; do
    openssl req -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes \
        -subj "/CN=VLAPS test $name" -keyout "$name-key.pem" -out "$name.csr"
done
sign="openssl ca -batch -notext -config ca.conf -keyfile authority-key.pem"
$sign -selfsign -extensions authority -in authority.csr -out authority.pem
$sign -cert authority.pem -extensions server -in server.csr -out server.pem
cp authority.pem server.pem server-key.pem "$here"
