#!/bin/sh
# Certificates and configurations for one cell, a folder for each party: what its container mounts at /etc/treewright/tls.
# Usage: TREEWRIGHT_CELL=CELL make-certificates.sh FOLDER ROUTER_HOST [PARTY...]
# Default parties: recorder cell operator service controller. Run again to renew: the authority stays, each file is
# replaced at once. As root, keys are given to the containers' user (TREEWRIGHT_UID, 1000).
set -eu
cell=${TREEWRIGHT_CELL:?the name of the cell}
here=$(cd "$(dirname "$0")" && pwd)
folder=$1 host=$2
shift 2
[ $# -gt 0 ] || set -- recorder cell operator service controller
umask 077
mkdir -p "$folder/authority"
cd "$folder"

[ -e authority/ca.pem ] || openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 3650 \
  -subj "/CN=treewright cell authority" -keyout authority/ca.key -out authority/ca.pem 2>/dev/null

certify() { # NAME EXTENSIONS
  mkdir -p "$1"
  new=$1/.new
  openssl req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj "/CN=$1" -keyout "$new.key" -out "$new.csr" \
    2>/dev/null
  printf '%s\n' "basicConstraints=critical,CA:FALSE" "$2" >"$new.ext"
  openssl x509 -req -in "$new.csr" -CA authority/ca.pem -CAkey authority/ca.key -CAcreateserial -days 825 \
    -extfile "$new.ext" -out "$new.pem" 2>/dev/null
  cp authority/ca.pem "$new.ca"
  [ "$(id -u)" -ne 0 ] || chown "${TREEWRIGHT_UID:-1000}" "$1" "$new.key" "$new.pem" "$new.ca"
  mv "$new.ca" "$1/ca.pem"
  mv "$new.key" "$1/$1.key"
  mv "$new.pem" "$1/$1.pem"
  rm "$new.csr" "$new.ext"
  [ ! -e "$here/$1.json5" ] || configure "$1"
}

configure() { # NAME
  sed -e "s/TREEWRIGHT_CELL/$cell/g" -e "s/TREEWRIGHT_ROUTER/$host/g" "$here/$1.json5" >"$1/zenoh.json5"
  [ "$(id -u)" -ne 0 ] || chown "${TREEWRIGHT_UID:-1000}" "$1/zenoh.json5"
}

certify router "subjectAltName=DNS:$host
extendedKeyUsage=serverAuth,clientAuth"
for party in "$@"; do
  certify "$party" "subjectAltName=DNS:$party
extendedKeyUsage=clientAuth"
done
