#!/bin/sh
# Puts GSRAIN into the desktop's menu: entry, icons, file types. PREFIX=~/.local (default) or /usr/local; --remove undoes it.
set -eu
here=$(dirname "$0")
share=${PREFIX:-$HOME/.local}/share
icons=$share/icons/hicolor

if [ "${1:-}" = --remove ]; then
    rm -f "$share/applications/gsrain.desktop" "$share/mime/packages/gsrain-mime.xml" "$icons"/*/apps/gsrain.png "$icons/scalable/apps/gsrain.svg"
else
    install -D -m 644 "$here/gsrain.desktop" "$share/applications/gsrain.desktop"
    install -D -m 644 "$here/gsrain-mime.xml" "$share/mime/packages/gsrain-mime.xml"
    install -D -m 644 "$here/gsrain.svg" "$icons/scalable/apps/gsrain.svg"
    for size in 16 24 32 48 64 256; do
        install -D -m 644 "$here/../app/icons/$size.png" "$icons/${size}x$size/apps/gsrain.png"
    done
fi
# Desktops without these tools look into the folders themselves.
if command -v update-mime-database >/dev/null && [ -d "$share/mime/packages" ]; then update-mime-database "$share/mime"; fi
if command -v update-desktop-database >/dev/null; then update-desktop-database "$share/applications"; fi
