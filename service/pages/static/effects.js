// What was adopted, as a part of the network that a page shows.

/** The network with what was adopted: an effect that is added has the unit of its input or quantity,
    all else its own. A dormant parameter that woke stands in its place, with its bounds as adopted. */
export function withEffects(network, effects) {
  const { parameters = [], drifts = [], biases = [] } = effects ?? {};
  const added = (list) => list.filter((one) => one.how === "plus");
  const units = new Map([
    ...added(drifts).map((d) => [d.name, network.parameters.find((p) => p.name === d.input)?.unit]),
    ...added(biases).map((b) => [b.name, network.quantities.find((q) => q.name === b.quantity)?.unit])]);
  const adopted = parameters.map((p) => ({ ...p, level: `${p.level}, adopted`, unit: units.get(p.name) ?? p.unit }));
  const names = new Set(adopted.map((p) => p.name));
  return { ...network, parameters: [...network.parameters.filter((p) => !names.has(p.name)), ...adopted] };
}
