% A run of labrig in MATLAB: where the axes went, the radius of each insertion, and the mean of each gel.
%
%   labrig export data/runs/NAME --mat --out NAME-tables
%
% then, in MATLAB, with run.mat in the present folder:
%
%   read_run
%
% run.mat holds a struct a table: states, events, trials, frames, truth (simulated rigs), measurements, specimens.
% Each field is a column; its unit stands in its name. Text is a cell array, an unknown number NaN.

tables = load('run.mat');
fprintf('%s: %s, %s\n', tables.run.run, tables.run.experiment, tables.run.exit_status);

% Where the axes went, over rig time.
states = struct2table(tables.states);
figure;
plot(states.t_s, states.insertion_mm, states.t_s, states.linear_mm);
xlabel('rig time [s]');
ylabel('position [mm]');
legend('needle', 'sheath');

% The radius of each insertion that could be measured, with its 95 % interval.
measured = struct2table(tables.measurements);
final = measured(strcmp(measured.role, 'final') & measured.accepted == 1, :);
figure;
errorbar(final.trial, final.radius_mm, final.radius_mm - final.radius_ci95_low_mm, ...
    final.radius_ci95_high_mm - final.radius_mm, 'o');
xlabel('trial');
ylabel('radius [mm]');

% The mean of each gel, computed again from the radii; specimens holds what labrig computed.
[group, gel] = findgroups(final.gelatin_percent);
mean_radius_mm = splitapply(@mean, final.radius_mm, group);
disp(table(gel, mean_radius_mm));
disp(struct2table(tables.specimens, 'AsArray', isscalar(tables.specimens.n)));
