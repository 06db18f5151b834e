# A rehearsal of calibrations and sign-off on twins whose clock is faster (docs/sign_off.md). white.toml and
# white-plan.toml of the tour lie in this folder. Say `sh rehearse.sh serve` in one terminal, `sh rehearse.sh` in another.
set -e
if [ "$1" = serve ]; then
gonio rig show lab > lab.toml
sed -i -e '1i truth = "lab.truth.toml"' -e 's/-95.0, 95.0/-120.0, 120.0/' \
    -e 's/^zero_u_deg = 0.02/zero_u_deg = 1.0/' -e 's/^width = 640/width = 320/' \
    -e 's/^height = 480/height = 240/' -e 's/^pixel_um = 5.0/pixel_um = 10.0/' \
    -e 's/^focal_length_mm = 100.0/focal_length_mm = 50.0/' lab.toml
cat >> lab.toml <<X

[holder.fiducials]
count = 4
marker_mm = 8.0
ring_mm = 18.0
X
cat > lab.truth.toml <<X
[arms.light]
zero_offset_deg = 1.37
[arms.camera]
zero_offset_deg = -0.62
[camera]
electrons_per_dn = 3.1
[lamp]
noise = 0.004
warm_up_loss = 0.08
warm_up_time_constant_s = 420.0
drift_per_hour = 0.008
beam = { xx_per_mm2 = -2e-4, yy_per_mm2 = -1.5e-4 }
X
gonio sim serve --rig lab.toml --sample white.toml --time-scale 20
exit
fi
gonio calibrate geometry --rig twin/rig.toml --out geometry.toml --quick --yes
cp twin/rig.toml rehearsal.toml
printf '\n[calibration]\nfiles = ["geometry.toml"]\n' >> rehearsal.toml
gonio calibrate camera --rig rehearsal.toml --out camera.toml --yes
sed -i 's/^files = .*/files = ["geometry.toml", "camera.toml"]/' rehearsal.toml
sleep 120      # the lamp cools: 40 of its minutes
gonio calibrate light --rig rehearsal.toml --out light.toml --minutes 3 --every 1 --yes
sed -i 's/^files = .*/files = ["geometry.toml", "camera.toml", "light.toml"]/' rehearsal.toml
gonio measure white-plan.toml --rig rehearsal.toml --out white --yes
gonio reduce white
gonio compare white white.toml --change --out sign-off
