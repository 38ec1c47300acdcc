#!/bin/sh
# Certificates for one cell: an authority of its own, the router's, and one for each party, named by its common name.
# Usage: make-certificates.sh FOLDER ROUTER_HOST [PARTY...]      default parties: recorder cell operator service controller
set -eu
folder=$1 host=$2
shift 2
[ $# -gt 0 ] || set -- recorder cell operator service controller
umask 077
mkdir -p "$folder"
cd "$folder"

[ -e ca.pem ] || openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 3650 \
  -subj "/CN=treewright cell authority" -keyout ca.key -out ca.pem 2>/dev/null

certify() { # NAME EXTENSIONS
  openssl req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj "/CN=$1" -keyout "$1.key" -out "$1.csr" 2>/dev/null
  printf '%s\n' "basicConstraints=critical,CA:FALSE" "$2" >"$1.ext"
  openssl x509 -req -in "$1.csr" -CA ca.pem -CAkey ca.key -CAcreateserial -days 825 -extfile "$1.ext" -out "$1.pem" \
    2>/dev/null
  rm "$1.csr" "$1.ext"
}

certify router "subjectAltName=DNS:$host
extendedKeyUsage=serverAuth,clientAuth"
for party in "$@"; do
  certify "$party" "subjectAltName=DNS:$party
extendedKeyUsage=clientAuth"
done
