#!/bin/sh
# Makes the certificates of lab/tests/actor_network.rs again, valid from 2020 to 2120, as
# `./vlaps link` makes them: an authority, the side that listens, an actor, a view, an actor
# whose invitation has ended, and an actor of another authority. The keys protect nothing but
# that test.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
made=$(mktemp -d)
trap 'rm -rf "$made"' EXIT
cd "$made"
peer=00112233445566778899aabbccddeeff
cat >ca.conf <<END
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
unique_subject = no
[names]
commonName = supplied
[authority]
basicConstraints = critical, CA:TRUE
[listener]
extendedKeyUsage = serverAuth
subjectAltName = DNS:vehicle.vlaps-link
[actor]
extendedKeyUsage = clientAuth
subjectAltName = DNS:actor.vlaps-link, DNS:$peer.peer.vlaps-link
[view]
extendedKeyUsage = clientAuth
subjectAltName = DNS:view.vlaps-link, DNS:$peer.peer.vlaps-link
END
: >issued
for name in authority other listener actor view ended foreign; do
    openssl req -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes \
        -subj "/CN=VLAPS test $name" -keyout "$name-key.pem" -out "$name.csr"
done
for name in authority other; do
    openssl ca -batch -notext -config ca.conf -keyfile "$name-key.pem" \
        -selfsign -extensions authority -in "$name.csr" -out "$name.pem"
done
sign() {
    openssl ca -batch -notext -config ca.conf -cert "$1.pem" -keyfile "$1-key.pem" \
        -extensions "$3" -in "$2.csr" -out "$2.pem" $4
}
sign authority listener listener ""
sign authority actor actor ""
sign authority view view ""
sign authority ended actor "-enddate 20210101000000Z"
sign other foreign actor ""
for name in listener actor view ended foreign; do
    cp "$name.pem" "$name-key.pem" "$here"
done
cp authority.pem "$here"
