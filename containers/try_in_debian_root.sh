#!/bin/sh
# Runs containers/install.sh and a job in a bare Debian root, as root: sh containers/try_in_debian_root.sh DIRECTORY
# It needs debootstrap. The certificates that this machine trusts are used, since its package index may be a mirror.
set -eu
root=$1
cd "$(dirname "$0")/.."
[ -e "$root/etc/debian_version" ] || debootstrap --variant=minbase trixie "$root"
cp /etc/resolv.conf "$root/etc/"
mkdir -p "$root/opt/hpcinv"
cp /etc/ssl/certs/ca-certificates.crt "$root/opt/certificates.crt"
git ls-files -z | tar --null --files-from=- -cf - | tar -xf - -C "$root/opt/hpcinv"
mountpoint -q "$root/proc" || mount -t proc proc "$root/proc"
trap 'umount "$root/proc"' EXIT
inside() { env -i PATH="$PATH" HOME=/root SSL_CERT_FILE=/opt/certificates.crt PIP_CERT=/opt/certificates.crt chroot "$root" "$@"; }
inside sh /opt/hpcinv/containers/install.sh
inside sh -c 'cd /opt/hpcinv && mpirun -n 2 hpcinv run jobs/column.yaml --output /tmp/column --overwrite'
