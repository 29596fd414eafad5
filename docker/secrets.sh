#!/bin/sh
# Makes the passwords of docker/compose.yaml in docker/secrets, or in the folder that is given.
# What is there already stays. Compose mounts each file as it is, and the users inside differ from
# the one outside: so the files are readable, and the folder keeps other users of this machine out.
set -eu
folder=${1:-$(dirname "$0")/secrets}
mkdir -p "$folder"
chmod 700 "$folder"

password() {
    od -An -N24 -tx1 /dev/urandom | tr -d ' \n'
}

keep() {
    if [ ! -s "$folder/$1" ]; then
        printf '%s\n' "$2" >"$folder/$1.new"
        chmod 444 "$folder/$1.new"
        mv "$folder/$1.new" "$folder/$1"
    fi
}

keep postgres_password "$(password)"
keep grafana_password "$(password)"
keep webhook_key "$(password)$(password)"
keep database_url "postgresql://bladetwin:$(cat "$folder/postgres_password")@db/bladetwin"
